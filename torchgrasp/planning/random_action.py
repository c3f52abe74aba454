"""Actions by chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.randomness import MomentGenerators


class RandomAction(TensorDictModuleBase):
    """Uniform actions within their bounds: what chance alone achieves.

    Args:
        action_bound: largest magnitude of each component, metres and radians.
        seed: of the draws.
    """

    def __init__(self, *, action_bound: Sequence[float] = ACTION_BOUND, seed: int = 0) -> None:
        super().__init__()
        self.in_keys = [keys.WORLD, keys.EPISODE, keys.TIME_LEFT]
        self.out_keys = [keys.ACTION]
        self._bound = np.array(action_bound)
        self._generators = MomentGenerators(seed, purpose="RandomAction")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ACTION (*, 6)."""
        draws = np.array([rng.uniform(-self._bound, self._bound) for rng in self._generators(tensordict)])
        action = torch.from_numpy(draws.astype(np.float32)).reshape(*tensordict.batch_size, -1)
        return tensordict.set(keys.ACTION, action.to(tensordict.device))
