"""Episodes that the expert begins and the learner ends (Sec. 3.5)."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.errors import check_range
from torchgrasp.randomness import MomentGenerators


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
        check_range("probability", probability, 0.0, 1.0)
        check_range("max_steps", max_steps, 1, horizon)
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
        self._generators = MomentGenerators(seed, purpose="ExpertStart", per_episode=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Put EXPERT_ACTION (*, 6) in the place of ACTION where it is the expert's turn."""
        steps = torch.tensor([self._draw_steps(generator) for generator in self._generators(tensordict)])
        elapsed = (1.0 - tensordict.get(keys.TIME_LEFT)) * self.horizon
        turn = elapsed.round() < steps.reshape(*tensordict.batch_size, 1).to(elapsed.device)
        turn &= tensordict.get(keys.HAS_EXPERT)
        action = torch.where(turn, tensordict.get(keys.EXPERT_ACTION), tensordict.get(keys.ACTION))
        return tensordict.set(keys.ACTION, action)

    def _draw_steps(self, generator: np.random.Generator) -> int:
        """How many steps the expert acts in an episode."""
        begins = generator.random() < self.probability
        return int(generator.integers(1, self.max_steps + 1)) if begins else 0
