"""WriteJournal: which rows were written, told by the processes that write to the one that samples."""

from __future__ import annotations

import torch
from torch import Tensor

# Spans kept: a reader that falls back by more is told so.
_NUM_SPANS = 1024


class WriteJournal:
    """The rows that were written last, in memory that lies open to other processes.

    A replay buffer that is handed to collecting processes hands its journal on: all of them post to the
    same one, and a reader keeps its own place in it. Writers must take turns, as TorchRL's shared buffers do
    by their write lock.

    >>> journal = WriteJournal()
    >>> journal.post(torch.tensor([4, 5, 6, 9]))
    >>> journal.read().tolist(), journal.read().tolist(), journal.num_posts
    ([4, 5, 6, 9], [], 1)
    """

    def __init__(self) -> None:
        # First how many posts and how many spans there were, then the last spans: first row, last row + 1.
        self._shared = torch.zeros(1 + _NUM_SPANS, 2, dtype=torch.int64).share_memory_()
        self._place = 0

    @property
    def num_posts(self) -> int:
        """How often `post` was called, by all processes."""
        return int(self._shared[0, 0])

    def post(self, rows: Tensor) -> None:
        """Note that `rows` (k) int64, distinct and in their order, were written."""
        spans = _find_spans(rows)
        if len(spans) <= _NUM_SPANS:
            self._shared[self._find_slots(int(self._shared[0, 1]), len(spans))] = spans
        self._shared[0] += torch.tensor([1, len(spans)])

    def read(self) -> Tensor | None:
        """(k) int64 rows posted since the last call, in their order; None where they are too many to know."""
        end = int(self._shared[0, 1])
        start, self._place = self._place, end
        if end - start > _NUM_SPANS:
            return None
        spans = self._shared[self._find_slots(start, end - start)].tolist()
        if not spans:
            return torch.empty(0, dtype=torch.int64)
        return torch.cat([torch.arange(*span) for span in spans]).unique()

    @staticmethod
    def _find_slots(start: int, count: int) -> Tensor:
        return 1 + torch.arange(start, start + count) % _NUM_SPANS


def _find_spans(rows: Tensor) -> Tensor:
    """(n, 2) first and last + 1 of each run of whole numbers in `rows` (k)."""
    if not rows.numel():
        return rows.new_empty(0, 2)
    gap = rows.diff() != 1
    edge = gap.new_ones(1)
    return torch.stack((rows[torch.cat((edge, gap))], rows[torch.cat((gap, edge))] + 1), dim=-1)
