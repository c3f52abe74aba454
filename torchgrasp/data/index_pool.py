"""A set of integers that is drawn from uniformly at a cost independent of its size."""

from __future__ import annotations

import torch
from torch import Tensor

from torchgrasp.errors import ConfigError


class IndexPool:
    """A set of row numbers with O(k) insertion, removal and uniform draws of k members.

    Members lie packed at the front of one vector; a second vector holds the place of each.
    Removing a member moves one from the end into its place. Where the `span` of the row numbers is
    known, both vectors are as long as that from the first member on; otherwise they grow by doubling.

    Args:
        span: the row numbers that may come, without gaps; any from 0 on if None.

    >>> pool = IndexPool()
    >>> pool.add(torch.tensor([4, 7, 9]))
    >>> pool.remove(torch.tensor([4, 5]))
    >>> sorted(pool.members.tolist())
    [7, 9]
    """

    def __init__(self, span: range | None = None) -> None:
        self._span = span
        self._first = 0 if span is None else span.start
        self._rows = torch.empty(0, dtype=torch.int64)
        self._place = torch.empty(0, dtype=torch.int64)
        self._size = 0

    def __len__(self) -> int:
        return self._size

    @property
    def members(self) -> Tensor:
        """(n) int64: the members in the order that draws depend on; a view."""
        return self._rows[: self._size]

    def add(self, rows: Tensor) -> None:
        """Insert distinct `rows` (k) int64; those already in stay where they are."""
        if not rows.numel():
            return
        low, high = int(rows.min()), int(rows.max())
        if self._span is not None and not (low in self._span and high in self._span):
            raise ConfigError(
                f"Rows {low} to {high} were written for a source whose span is {self._span}: give the "
                "sampler the spans of its storage (MixtureStorage.spans), or none."
            )
        self._reserve(high + 1 - self._first)
        rows = rows[self._find(rows) < 0]
        places = torch.arange(self._size, self._size + rows.numel())
        self._rows[places] = rows
        self._put(rows, places)
        self._size += rows.numel()

    def remove(self, rows: Tensor) -> None:
        """Take out distinct `rows` (k) int64; those not in are passed over."""
        rows = rows[self.contains(rows)]
        holes = self._find(rows)
        self._put(rows, -1)
        before, self._size = self._size, self._size - rows.numel()
        tail = self._rows[self._size : before]
        movers = tail[self._find(tail) >= 0]
        holes = holes[holes < self._size]
        sources = self._find(movers)
        self._rows[holes] = movers
        self._put(movers, holes)
        self._move(sources, holes, range(self._size, before))

    def _find(self, rows: Tensor) -> Tensor:
        """(k) places of `rows` (k) within the vectors' span, -1 of those not in."""
        return self._place[rows - self._first]

    def _put(self, rows: Tensor, places: Tensor | int) -> None:
        self._place[rows - self._first] = places

    def contains(self, rows: Tensor) -> Tensor:
        """(k) bool: which of any `rows` (k) int64 are members."""
        local = rows - self._first
        known = (local >= 0) & (local < self._place.numel())
        known[known.clone()] = self._place[local[known]] >= 0
        return known

    def _move(self, sources: Tensor, places: Tensor, removed: range) -> None:
        """What belongs to members goes with them: from `sources` (k) to `places` (k); `removed` are empty."""

    def draw(self, num_rows: int, generator: torch.Generator | None) -> Tensor:
        """(num_rows) int64 members, uniform and with replacement."""
        if not num_rows:
            return self._rows[:0]
        return self._rows[torch.randint(self._size, (num_rows,), generator=generator)]

    def load(self, members: Tensor) -> None:
        """Replace the set by `members`, in their order."""
        self._size = 0
        self._place.fill_(-1)
        self.add(members.to("cpu", torch.int64))

    def _reserve(self, num_rows: int) -> None:
        old = self._place.numel()
        if num_rows <= old:
            return
        new = max(num_rows, 2 * old, 1024) if self._span is None else len(self._span)
        self._place = torch.cat((self._place, torch.full((new - old,), -1, dtype=torch.int64)))
        self._rows = torch.cat((self._rows, torch.zeros(new - old, dtype=torch.int64)))
