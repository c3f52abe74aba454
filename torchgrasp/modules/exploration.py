"""Exploration: noise of Sec. 6.4, one large change an episode, and last actions that are only tried."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, dispatch
from tensordict.nn.probabilistic import InteractionType, interaction_type
from tensordict.utils import NestedKey
from torch import Tensor

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules.heads import bound_tensor
from torchgrasp.randomness import MomentGenerators

# Sec. 6.4: 3 cm and 8 degrees, decaying to 0.5 cm and 1 degree.
NOISE_START = (0.03,) * 3 + (math.radians(8),) * 3
NOISE_END = (0.005,) * 3 + (math.radians(1),) * 3


class DecayingUniformNoise(TensorDictModuleBase):
    """Adds uniform noise to each component of the action (*, A) under ExplorationType.RANDOM only.

    The range shrinks linearly from ±`start` to ±`end` over `annealing_steps` steps, counted by
    `step`; actions stay within their bounds. Euler angles are components like the
    others. It follows the actor: ``TensorDictSequential(actor, noise)``.

    Draws belong to a moment of an episode where the tensordict names one (`MomentGenerators`), so
    that neither the number of workers nor a restart changes them. The counter is a buffer: it travels
    with the weights.

    Args:
        annealing_steps: steps until the range is ±`end`; 0 starts there.
        start: half range of each component at first (m, rad).
        end: the same after `annealing_steps`.
        action_bound: largest magnitude of each component.
        seed: of the draws.
        action_key: what is changed.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchrl.envs.utils import ExplorationType, set_exploration_type
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
        bound = bound_tensor(action_bound)
        if not len(start) == len(end) == len(bound):
            raise ConfigError(
                f"start, end and action_bound have {len(start)}, {len(end)} and {len(bound)} numbers: "
                "give each one a component of the action."
            )
        self.in_keys = [action_key]  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = [action_key]  # pyright: ignore[reportAttributeAccessIssue]
        self.action_key = action_key
        self.annealing_steps = annealing_steps
        self.register_buffer("start", torch.tensor(tuple(start)))
        self.register_buffer("end", torch.tensor(tuple(end)))
        self.register_buffer("bound", bound)
        self.register_buffer("steps", torch.zeros((), dtype=torch.long))
        self._generators = MomentGenerators(seed, purpose="DecayingUniformNoise")

    @property
    def half_range(self) -> Tensor:
        """(A,) current largest magnitude of the noise on each component."""
        progress = (self.steps / self.annealing_steps).clamp(max=1.0) if self.annealing_steps else 1.0
        return self.start + progress * (self.end - self.start)

    def step(self, frames: int = 1) -> None:
        """Count `frames` more environment steps towards the final range."""
        self.steps += frames

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change the action in place of the one in `tensordict`."""
        # TorchRL's ExplorationType by its own name: networks then load without TorchRL's environments.
        if interaction_type() is InteractionType.RANDOM:
            action = tensordict.get(self.action_key)
            size = action.shape[-1]
            draws = np.array([rng.uniform(-1, 1, size) for rng in self._generators(tensordict)])
            unit = torch.from_numpy(draws).reshape(action.shape)
            noisy = action + unit.to(action) * self.half_range
            tensordict.set(self.action_key, noisy.clamp(-self.bound, self.bound))
        return tensordict


class ExploringStep(TensorDictModuleBase):
    """Changes the action (*, A) of one step of each episode by much, under ExplorationType.RANDOM only.

    The policy acts at all other steps, so that how the episode ends is exactly what that one action is worth
    under the policy (exploring starts: Sutton and Barto 2018, Sec. 5.3). Noise at every step tells that of a
    noisy policy. The step is drawn uniformly, the change in a direction at random, of a size that is uniform
    up to `reach`. It follows the actor: ``TensorDictSequential(actor, step)``.

    Draws belong to an episode where the tensordict names it (`MomentGenerators`).

    Args:
        horizon: T of the environment.
        first: first step that may be changed, from 0.
        reach: largest change, its length (A,) in units of `action_bound`.
        action_bound: largest magnitude of each component of the action, to which the sum is clipped.
        seed: of the draws.
        action_key: what is changed.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchrl.envs.utils import ExplorationType, set_exploration_type
        >>> step = ExploringStep(horizon=30, first=20)
        >>> moment = {"world": torch.tensor([[0]]), "episode": torch.tensor([[7]])}
        >>> with set_exploration_type(ExplorationType.RANDOM):
        ...     changed = [
        ...         step(TensorDict({**moment, "time_left": torch.tensor([[1 - t / 30]]),
        ...                          "action": torch.zeros(1, 6)}, [1]))["action"].any().item()
        ...         for t in range(30)
        ...     ]
        >>> sum(changed), any(changed[:20])
        (1, False)
    """

    bound: Tensor

    def __init__(
        self,
        *,
        horizon: int,
        first: int = 0,
        reach: float = 1.0,
        action_bound: Sequence[float] = ACTION_BOUND,
        seed: int = 0,
        action_key: NestedKey = keys.ACTION,
    ) -> None:
        super().__init__()
        check_whole("horizon", horizon, 1)
        check_whole("first", first, 0, horizon - 1)
        check_range("reach", reach, 0.0, float("inf"))
        self.horizon, self.first, self.reach, self.action_key = horizon, first, reach, action_key
        self.register_buffer("bound", bound_tensor(action_bound))
        self.in_keys = [action_key, keys.TIME_LEFT]  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = [action_key]  # pyright: ignore[reportAttributeAccessIssue]
        self._generators = MomentGenerators(seed, purpose="ExploringStep", per_episode=True)

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Change the action in place of the one in `tensordict`, where its step has come."""
        if interaction_type() is not InteractionType.RANDOM:
            return tensordict
        action = tensordict.get(self.action_key)
        drawn = [self._draw(rng, action.shape[-1]) for rng in self._generators(tensordict)]
        steps = torch.tensor([step for step, _ in drawn]).reshape(*action.shape[:-1], 1)
        change = torch.from_numpy(np.array([change for _, change in drawn])).reshape(action.shape)
        elapsed = ((1.0 - tensordict.get(keys.TIME_LEFT)) * self.horizon).round()
        due = elapsed == steps.to(elapsed)
        changed = (action + change.to(action) * self.bound).clamp(-self.bound, self.bound)
        return tensordict.set(self.action_key, torch.where(due, changed, action))

    def _draw(self, rng: np.random.Generator, size: int) -> tuple[int, np.ndarray]:
        """The step that is changed, and by how much in units of the bound."""
        return int(rng.integers(self.first, self.horizon)), _draw_change(rng, size, self.reach)


class NearbyActions(TensorDictModuleBase):
    """Proposes M actions near the action (*, A) of an episode's last step, under ExplorationType.RANDOM only.

    An environment that can try actions without taking them, as GraspEnv does in copies of its worlds, tells
    what each would have brought. One state then shows a critic which of its actions succeed and which fail,
    which no number of episodes with one action a state does (vine rollouts: Schulman et al. 2015, arXiv
    1502.05477, Sec. 5.2). `split_tries` makes transitions of them.

    It follows the actor, before any noise: ``TensorDictSequential(actor, nearby, noise)``. The first
    proposal is the actor's own action, the others change it in a direction at random, by a size that is
    uniform up to `reach`. At other steps all proposals are zero. Draws belong to a moment of an episode where
    the tensordict names one (`MomentGenerators`).

    Args:
        horizon: T of the environment.
        num_tries: M.
        reach: largest change, its length (A,) in units of `action_bound`.
        action_bound: largest magnitude of each component of the action, to which the sum is clipped.
        seed: of the draws.
        action_key: of the actor's action.
        tried_key: where the proposals (*, M, A) are written.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchrl.envs.utils import ExplorationType, set_exploration_type
        >>> nearby = NearbyActions(horizon=30, num_tries=4)
        >>> state = TensorDict({"time_left": torch.tensor([[1 / 30]]), "action": torch.zeros(1, 6)}, [1])
        >>> with set_exploration_type(ExplorationType.RANDOM):
        ...     tried = nearby(state)["tried_action"]
        >>> tried.shape, tried.any(dim=-1).tolist()
        (torch.Size([1, 4, 6]), [[False, True, True, True]])
    """

    bound: Tensor

    def __init__(
        self,
        *,
        horizon: int,
        num_tries: int = 8,
        reach: float = 1.0,
        action_bound: Sequence[float] = ACTION_BOUND,
        seed: int = 0,
        action_key: NestedKey = keys.ACTION,
        tried_key: NestedKey = keys.TRIED_ACTION,
    ) -> None:
        super().__init__()
        check_whole("horizon", horizon, 1)
        check_whole("num_tries", num_tries, 1)
        check_range("reach", reach, 0.0, float("inf"))
        self.horizon, self.num_tries, self.reach = horizon, num_tries, reach
        self.action_key, self.tried_key = action_key, tried_key
        self.register_buffer("bound", bound_tensor(action_bound))
        self.in_keys = [action_key, keys.TIME_LEFT]  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = [tried_key]  # pyright: ignore[reportAttributeAccessIssue]
        self._generators = MomentGenerators(seed, purpose="NearbyActions")

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the proposals; none without exploration."""
        if interaction_type() is not InteractionType.RANDOM:
            return tensordict
        action = tensordict.get(self.action_key)
        tried = action.new_zeros(*action.shape[:-1], self.num_tries, action.shape[-1])
        left = (tensordict.get(keys.TIME_LEFT).reshape(-1) * self.horizon).round()
        due = (left <= 1).nonzero().squeeze(-1).tolist()
        if due:
            draws = [self._draw(rng, action.shape[-1]) for rng in self._generators(tensordict, due)]
            change = torch.from_numpy(np.array(draws)).to(action) * self.bound
            own = action.reshape(-1, 1, action.shape[-1])[due]
            proposed = (own + change).clamp(-self.bound, self.bound)
            tried.reshape(-1, *tried.shape[-2:])[due] = proposed
        return tensordict.set(self.tried_key, tried)

    def _draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """(M, A) changes in units of the bound, the first none."""
        changes = [_draw_change(rng, size, self.reach) for _ in range(self.num_tries - 1)]
        return np.stack([np.zeros(size), *changes])


def _draw_change(rng: np.random.Generator, size: int, reach: float) -> np.ndarray:
    """A change (size,) in a direction at random, in units of the bound."""
    direction = rng.normal(size=size)
    return reach * rng.random() * direction / np.linalg.norm(direction)
