"""Prioritised replay (Schaul et al. 2016): rows drawn in proportion to their errors."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchgrasp.data.index_pool import IndexPool
from torchgrasp.data.sum_tree import SumTree
from torchgrasp.errors import ConfigError, check_range


@dataclass(frozen=True)
class Priority:
    """How strongly rows are preferred: P(i) ~ (|δ_i| + eps)^alpha, corrected by (N P(i))^-beta.

    The defaults are those of Schaul et al. for the proportional variant.

    Attributes:
        alpha: 0 draws uniformly, 1 in proportion to the errors.
        beta: 1 corrects the bias of the draws in full; annealed to 1 by `MixtureSampler.beta`.
        eps: added to every error, so that rows without one are drawn, too.
    """

    alpha: float = 0.6
    beta: float = 0.4
    eps: float = 1e-6

    def __post_init__(self) -> None:
        check_range("alpha", self.alpha, 0.0, 1.0)
        check_range("beta", self.beta, 0.0, 1.0)
        check_range("eps", self.eps, 0.0, float("inf"), open_low=True)

    def weigh(self, errors: Tensor) -> Tensor:
        """(*) errors to (*) float64 weights of the draw."""
        if not bool(errors.isfinite().all()):
            raise ConfigError(
                "A priority is NaN or infinite: look at the loss that wrote it, or lower its learning rate."
            )
        return (errors.detach().to("cpu", torch.float64).abs() + self.eps) ** self.alpha


class PriorityPool(IndexPool):
    """An IndexPool whose members are drawn in proportion to weights.

    A row that is added, or added again because it was overwritten, gets the largest weight that any
    row of the pool has had, 1 at first, so that it is drawn soon.

    Args:
        span: the row numbers that may come; any from 0 on if None.

    >>> pool = PriorityPool()
    >>> pool.add(torch.tensor([4, 7]))
    >>> pool.set_weights(torch.tensor([7]), torch.tensor([3.0]))
    >>> pool.relative(torch.tensor([4, 7]))  # N P(i)
    tensor([0.5000, 1.5000], dtype=torch.float64)
    """

    def __init__(self, span: range | None = None) -> None:
        super().__init__(span)
        self._tree = self._make_tree()
        self.largest: float | None = None

    def _make_tree(self) -> SumTree:
        return SumTree(None if self._span is None else len(self._span))

    @property
    def weights(self) -> Tensor:
        """(n) float64: the weights of `members`."""
        return self._tree.get(torch.arange(len(self)))

    def add(self, rows: Tensor) -> None:
        """Insert distinct `rows` (k) int64, those already in as well, with the largest weight."""
        super().add(rows)
        largest = 1.0 if self.largest is None else self.largest
        self._tree.set(self._find(rows), torch.full(rows.shape, largest, dtype=torch.float64))

    def _move(self, sources: Tensor, places: Tensor, removed: range) -> None:
        self._tree.set(places, self._tree.get(sources))
        gone = torch.arange(removed.start, removed.stop)
        self._tree.set(gone, torch.zeros(len(gone), dtype=torch.float64))

    def draw(self, num_rows: int, generator: torch.Generator | None) -> Tensor:
        """(num_rows) int64 members, one from each of as many equal slices of the weights (App. B.2.1)."""
        if not num_rows:
            return self._rows[:0]
        shift = torch.rand(num_rows, generator=generator, dtype=torch.float64)
        masses = (torch.arange(num_rows) + shift) * (self._tree.total / num_rows)
        return self._rows[self._tree.find(masses)]

    def relative(self, rows: Tensor) -> Tensor:
        """(k) float64: how often each of the members `rows` is drawn, relative to a uniform draw: N P(i)."""
        return self._tree.get(self._find(rows)) * (len(self) / self._tree.total)

    def set_weights(self, rows: Tensor, weights: Tensor) -> None:
        """Set the weights (k) of `rows` (k); those not in, such as stubs written since, are passed over."""
        known = self.contains(rows)
        rows, weights = rows[known], weights[known]
        if rows.numel():
            self._tree.set(self._find(rows), weights)
            largest = float(weights.max())
            self.largest = largest if self.largest is None else max(self.largest, largest)

    def load(self, members: Tensor, weights: Tensor | None = None) -> None:
        """Replace the pool by `members` with their weights (n); the largest of all if None."""
        self._tree = self._make_tree()
        super().load(members)
        if weights is not None:
            self._tree.set(torch.arange(len(self)), weights)
