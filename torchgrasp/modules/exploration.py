"""Exploration noise of Sec. 6.4: uniform, large at first, then small."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.modules.heads import ACTION_BOUND, bound_tensor

# Sec. 6.4: 3 cm and 8 degrees, decaying to 0.5 cm and 1 degree.
NOISE_START = (0.03,) * 3 + (math.radians(8),) * 3
NOISE_END = (0.005,) * 3 + (math.radians(1),) * 3


class DecayingUniformNoise(TensorDictModuleBase):
    """Adds uniform noise to each component of the action (*, A) under ExplorationType.RANDOM only.

    The range shrinks linearly from ±`start` to ±`end` over `annealing_steps` steps, counted by
    `step`; actions stay within their bounds. Euler angles are components like the
    others. It follows the actor: ``TensorDictSequential(actor, noise)``.

    The counter is a buffer, so it travels to collectors with the weights; the generator's state is
    in the state_dict alone, so that it does not. Copies of one module draw the same noise: give
    each worker its own `seed`, here or by `set_seed`.

    Args:
        annealing_steps: steps until the range is ±`end`; 0 starts there.
        start: half range of each component at first (m, rad).
        end: the same after `annealing_steps`.
        action_bound: largest magnitude of each component.
        seed: of the module's own generator.
        action_key: what is changed.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchrl.envs.utils import set_exploration_type
        >>> noise = DecayingUniformNoise(annealing_steps=100)
        >>> with set_exploration_type(ExplorationType.RANDOM):
        ...     td = noise(TensorDict({"action": torch.zeros(4, 6)}, [4]))
        >>> bool((td["action"][:, :3].abs() <= 0.03).all()), bool((td["action"] != 0).all())
        (True, True)
    """

    start: Tensor
    end: Tensor
    bound: Tensor
    steps: Tensor

    def __init__(
        self,
        annealing_steps: int,
        *,
        start: Sequence[float] = NOISE_START,
        end: Sequence[float] = NOISE_END,
        action_bound: Sequence[float] = ACTION_BOUND,
        seed: int = 0,
        action_key: NestedKey = keys.ACTION,
    ) -> None:
        super().__init__()
        if annealing_steps < 0:
            raise ConfigError(
                f"annealing_steps={annealing_steps} is negative: 0 starts with the final range."
            )
        if not len(start) == len(end) == len(action_bound):
            raise ConfigError(
                f"start, end and action_bound have {len(start)}, {len(end)} and {len(action_bound)} numbers: "
                "give each one a component of the action."
            )
        self.in_keys = [action_key]  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = [action_key]  # pyright: ignore[reportAttributeAccessIssue]
        self.action_key = action_key
        self.annealing_steps = annealing_steps
        self.register_buffer("start", torch.tensor(tuple(start)))
        self.register_buffer("end", torch.tensor(tuple(end)))
        self.register_buffer("bound", bound_tensor(action_bound))
        self.register_buffer("steps", torch.zeros((), dtype=torch.long))
        self._generator = torch.Generator().manual_seed(seed)

    @property
    def half_range(self) -> Tensor:
        """(A,) current largest magnitude of the noise on each component."""
        progress = (self.steps / self.annealing_steps).clamp(max=1.0) if self.annealing_steps else 1.0
        return self.start + progress * (self.end - self.start)

    def step(self, frames: int = 1) -> None:
        """Count `frames` more environment steps towards the final range."""
        self.steps += frames

    def set_seed(self, seed: int) -> None:
        """Restart the noise from `seed`; the range stays."""
        self._generator.manual_seed(seed)

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change the action in place of the one in `tensordict`."""
        if exploration_type() is ExplorationType.RANDOM:
            action = tensordict.get(self.action_key)
            # Drawn on the CPU so that a seed gives the same noise on every device.
            unit = 2 * torch.rand(action.shape, generator=self._generator) - 1
            noisy = action + unit.to(action) * self.half_range
            tensordict.set(self.action_key, noisy.clamp(-self.bound, self.bound))
        return tensordict

    def get_extra_state(self) -> Tensor:
        """The generator's state, for the state_dict."""
        return self._generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Restore what get_extra_state returned."""
        self._generator.set_state(state.cpu())
