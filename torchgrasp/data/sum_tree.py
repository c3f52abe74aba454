"""Weights whose places are drawn in proportion to them, at a cost that grows with their logarithm."""

from __future__ import annotations

import torch
from torch import Tensor

# Children of a node: three levels hold 2 million weights, and a level costs one gather of short rows.
_FAN = 128


class SumTree:
    """Weights (n) >= 0 in float64 below the sums of 128 neighbours each, and so on up to one row.

    A change sums anew the blocks that it lies in, so that no error adds up, however long it is used.

    Args:
        capacity: the most weights that will come, for which there is room at once; room grows by doubling
            where it is None, or more come.

    >>> tree = SumTree()
    >>> tree.set(torch.tensor([0, 1, 2]), torch.tensor([1.0, 0.0, 3.0]))
    >>> tree.total, tree.find(torch.tensor([0.5, 1.0, 3.9]))
    (4.0, tensor([0, 2, 2]))
    """

    def __init__(self, capacity: int | None = None) -> None:
        self._build(torch.zeros(0, dtype=torch.float64), capacity or _FAN)

    @property
    def total(self) -> float:
        """The sum of all weights."""
        return float(self._levels[-1].sum())

    def get(self, places: Tensor) -> Tensor:
        """(k) float64 weights at `places` (k) int64."""
        return self._levels[0][places]

    def set(self, places: Tensor, weights: Tensor) -> None:
        """Set the weights at `places` (k) int64; of a place that is named twice, to one of the two."""
        if not places.numel():
            return
        self._reserve(int(places.max()) + 1)
        self._levels[0][places] = weights.to(torch.float64)
        for low, high in zip(self._levels, self._levels[1:], strict=False):
            places = torch.unique(places // _FAN)
            high[places] = low.view(-1, _FAN)[places].sum(dim=-1)

    def find(self, masses: Tensor) -> Tensor:
        """(k) places at which the running sum of the weights passes `masses` (k) in [0, total).

        A place without weight is never found.
        """
        node = torch.zeros_like(masses, dtype=torch.int64)
        left = masses.to(torch.float64)
        for level in reversed(self._levels):
            running = level.view(-1, _FAN)[node].cumsum(dim=-1)
            # Sums of one block in two orders may differ in their last bit.
            last = running[:, -1]
            left = torch.minimum(left, torch.nextafter(last, torch.zeros_like(last)))
            child = torch.searchsorted(running, left[:, None], right=True)
            before = running.gather(1, (child - 1).clamp_min(0))
            left = left - torch.where(child > 0, before, 0.0).squeeze(-1)
            node = node * _FAN + child.squeeze(-1)
        return node

    def _reserve(self, num_places: int) -> None:
        size = self._levels[0].numel()
        if num_places > size:
            self._build(self._levels[0], max(num_places, 2 * size))

    def _build(self, leaves: Tensor, size: int) -> None:
        """Room for `size` weights, of which `leaves` are the first."""
        self._levels = [_pad(leaves, size)]
        while (below := self._levels[-1]).numel() > _FAN:
            sums = below.view(-1, _FAN).sum(dim=-1)
            self._levels.append(_pad(sums, sums.numel()))


def _pad(values: Tensor, size: int) -> Tensor:
    """`values` with zeros behind, up to a multiple of the fan that holds `size`."""
    padded = torch.zeros(-(-size // _FAN) * _FAN, dtype=torch.float64)
    padded[: values.numel()] = values
    return padded
