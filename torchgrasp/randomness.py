"""Random numbers that belong to a moment of an episode, not to a process."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.errors import ConfigError

_TICKS = 1_000_000


class MomentGenerators:
    """Generators that follow from (seed, world, episode, time left) of each element of a batch.

    A draw then depends neither on its neighbours in the batch, nor on the number of processes, nor on
    what was drawn before: a run that is resumed needs no random state. Where a tensordict does not tell
    the moment, the number of calls so far stands in for it.

    Args:
        seed: of a run.
        purpose: what the draws are for; two purposes of one seed share no numbers.
        per_episode: whether the time left is left out, so that all steps of an episode draw the same.
    """

    def __init__(self, seed: int, *, purpose: str, per_episode: bool = False) -> None:
        if seed < 0:
            raise ConfigError(f"seed={seed} of {purpose}: give 0 or more.")
        self._key = (*_words(seed), zlib.crc32(purpose.encode()))
        self._names = (
            (keys.WORLD, keys.EPISODE) if per_episode else (keys.WORLD, keys.EPISODE, keys.TIME_LEFT)
        )
        self._calls = 0

    def __call__(
        self, tensordict: TensorDictBase, rows: Sequence[int] | None = None
    ) -> list[np.random.Generator]:
        """One generator for each element of the batch, in flat order, or for those in `rows` alone."""
        n = tensordict.batch_size.numel()
        rows = range(n) if rows is None else rows
        moment = [tensordict.get(name, None) for name in self._names]
        if any(each is None for each in moment):
            self._calls += 1
            return [self._generator(self._calls, i) for i in rows]
        columns = [self._count(name, each) for name, each in zip(self._names, moment, strict=True)]
        return [self._generator(*(column[i] for column in columns)) for i in rows]

    def _generator(self, *stream: int) -> np.random.Generator:
        # numpy takes a tuple for the same seed, but twice as long to read it.
        return np.random.default_rng(np.array((*self._key, *stream), dtype=np.uint32))

    @staticmethod
    def _count(name: str, entry: Tensor) -> list[int]:
        """An entry of the batch as whole numbers of at least 0."""
        column = entry.detach().cpu().numpy().reshape(-1)
        if name == keys.TIME_LEFT:
            column = np.rint(column * _TICKS).astype(np.int64)
        return np.maximum(column, 0).tolist()


def _words(number: int) -> list[int]:
    """A whole number in words of 32 bits, the lowest first, as numpy seeds with it."""
    words = [number & 0xFFFFFFFF]
    while number := number >> 32:
        words.append(number & 0xFFFFFFFF)
    return words
