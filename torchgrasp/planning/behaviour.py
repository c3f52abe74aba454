"""Who acts when data are collected: the expert, disturbed now and then, or the learner."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.errors import check_range
from torchgrasp.geometry import ACTION_BOUND
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
        check_range("disturb.probability", probability, 0.0, 1.0)
        self.in_keys = [keys.ACTION, keys.WORLD, keys.EPISODE, keys.TIME_LEFT]
        self.out_keys = [keys.ACTION, keys.PERTURBED]
        check_range("disturb.until", until, 0.0, 1.0)
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


class ExpertStart(TensorDictModuleBase):
    """Lets the expert act in the first steps of some episodes, the learner in the rest (Sec. 3.5).

    Args:
        probability: of an episode that the expert begins.
        max_steps: it acts for 1 to so many steps, drawn uniformly.
        horizon: T of the environment.
        seed: of the draws.
    """

    def __init__(self, *, horizon: int, probability: float = 0.5, max_steps: int = 10, seed: int = 0) -> None:
        super().__init__()
        check_range("expert_start.probability", probability, 0.0, 1.0)
        check_range("expert_start.max_steps", max_steps, 1, horizon)
        self.in_keys = [
            keys.ACTION,
            keys.EXPERT_ACTION,
            keys.HAS_EXPERT,
            keys.TIME_LEFT,
            keys.WORLD,
            keys.EPISODE,
        ]
        self.out_keys = [keys.ACTION]
        self.horizon, self.probability, self.max_steps = horizon, probability, max_steps
        self._key = (seed, zlib.crc32(b"ExpertStart"))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Put EXPERT_ACTION (*, 6) in the place of ACTION where it is the expert's turn."""
        n = tensordict.batch_size.numel()
        world, episode = (tensordict.get(key).reshape(n).tolist() for key in (keys.WORLD, keys.EPISODE))
        steps = torch.tensor([self._steps(*names) for names in zip(world, episode, strict=True)])
        elapsed = (1.0 - tensordict.get(keys.TIME_LEFT)) * self.horizon
        turn = elapsed.round() < steps.reshape(*tensordict.batch_size, 1).to(elapsed.device)
        turn &= tensordict.get(keys.HAS_EXPERT)
        action = torch.where(turn, tensordict.get(keys.EXPERT_ACTION), tensordict.get(keys.ACTION))
        return tensordict.set(keys.ACTION, action)

    def _steps(self, world: int, episode: int) -> int:
        """How many steps the expert acts in this episode."""
        rng = np.random.default_rng((*self._key, world, episode))
        return int(rng.integers(1, self.max_steps + 1)) if rng.random() < self.probability else 0


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
