"""Random numbers that belong to a moment of an episode, not to a process."""

from __future__ import annotations

import zlib

import numpy as np
import torch
from tensordict import TensorDictBase

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
    """

    def __init__(self, seed: int, *, purpose: str) -> None:
        if seed < 0:
            raise ConfigError(f"seed={seed} of {purpose}: give 0 or more.")
        self._key = (seed, zlib.crc32(purpose.encode()))
        self._calls = 0

    def __call__(self, tensordict: TensorDictBase) -> list[np.random.Generator]:
        """One generator for each element of the batch, in flat order."""
        rows = [tensordict.get(key, None) for key in (keys.WORLD, keys.EPISODE, keys.TIME_LEFT)]
        n = tensordict.batch_size.numel()
        if any(row is None for row in rows):
            self._calls += 1
            return [np.random.default_rng((*self._key, self._calls, i)) for i in range(n)]
        world, episode, time_left = (row.reshape(n).cpu() for row in rows)
        ticks = (time_left * _TICKS).round().long()
        streams = torch.stack((world, episode.clamp_min(0), ticks.clamp_min(0)), dim=-1).tolist()
        return [np.random.default_rng((*self._key, *stream)) for stream in streams]
