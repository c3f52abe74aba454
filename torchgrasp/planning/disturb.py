"""The expert disturbed now and then, so that demonstrations show how it recovers (Sec. 6.4)."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.errors import check_range
from torchgrasp.randomness import MomentGenerators


class Disturb(TensorDictModuleBase):
    """Adds a uniform disturbance to some actions and flags them PERTURBED (Sec. 6.4).

    The label stays clean, so that the learner sees how the expert recovers.

    Args:
        probability: of a disturbance at a step.
        until: no disturbance once less than this share of the episode is left, so that the expert has
            time to recover.
        translation: largest disturbance of each component, metres.
        rotation: the same of each Euler angle, radians.
        seed: of the disturbances.
    """

    def __init__(
        self,
        *,
        probability: float = 0.3,
        translation: float = 0.03,
        rotation: float = 0.14,
        until: float = 0.25,
        seed: int = 0,
    ) -> None:
        super().__init__()
        check_range("probability", probability, 0.0, 1.0)
        self.in_keys = [keys.ACTION, keys.WORLD, keys.EPISODE, keys.TIME_LEFT]
        self.out_keys = [keys.ACTION, keys.PERTURBED]
        check_range("until", until, 0.0, 1.0)
        self.probability, self.until = probability, until
        self._range = np.array([translation] * 3 + [rotation] * 3)
        self._generators = MomentGenerators(seed, purpose="Disturb")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change ACTION (*, 6) and write PERTURBED (*, 1)."""
        action = tensordict.get(keys.ACTION)
        draws = np.array([rng.uniform(-1, 1, 7) for rng in self._generators(tensordict)])
        early = tensordict.get(keys.TIME_LEFT).reshape(-1, 1).cpu().numpy() > self.until
        hit = (draws[:, :1] < 2 * self.probability - 1) & early
        noise = torch.from_numpy(draws[:, 1:] * self._range * hit).to(action).reshape(action.shape)
        tensordict.set(keys.ACTION, action + noise)
        flag = torch.from_numpy(hit).reshape(*tensordict.batch_size, 1).to(action.device)
        return tensordict.set(keys.PERTURBED, flag)
