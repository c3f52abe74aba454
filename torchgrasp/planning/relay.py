"""Relay: one policy begins an episode, another one ends it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.planning.plan import NO_PLANNER
from torchgrasp.randomness import MomentGenerators


class Relay(TensorDictModuleBase):
    """The first policy acts for the first k steps of an episode, the second one in the rest.

    "Combined" of Sec. 6.7 is a planned trajectory's first 20 steps, then a learned policy. The second
    policy does not see an episode before its turn, nor the first one after it: each is called with the worlds
    whose turn it is, so that a policy that remembers worlds must tell them apart by WORLD.

    Of what the two write, ACTION and PLAN_STATUS are kept; the latter is -1 where the one that acted has no
    planner. TURN tells which acted.

    Args:
        first: acts until its steps are over.
        second: acts from then on.
        steps: k, or the least and the most of it, (low, high), both included: then k is drawn uniformly for
            each episode.
        horizon: T of the environment.
        seed: of the draws, which belong to (seed, world, episode).

    Example:
        >>> from tensordict import TensorDict
        >>> from torchgrasp.planning import RandomAction
        >>> relay = Relay(RandomAction(), RandomAction(seed=1), steps=20, horizon=30)
        >>> state = {key: torch.zeros(1, dtype=torch.long) for key in ("world", "episode")}
        >>> relay(TensorDict({**state, "time_left": torch.tensor([1 / 3])}))["turn"]
        tensor([1])
    """

    def __init__(
        self,
        first: TensorDictModuleBase,
        second: TensorDictModuleBase,
        *,
        steps: int | Sequence[int],
        horizon: int,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.first, self.second = first, second
        self.low, self.high = _range(steps, horizon)
        self.horizon = horizon
        own = [keys.WORLD, keys.EPISODE, keys.TIME_LEFT]
        self.in_keys = list(dict.fromkeys([*own, *first.in_keys, *second.in_keys]))  # pyright: ignore
        self.out_keys = [keys.ACTION, keys.PLAN_STATUS, keys.TURN]
        self._generators = MomentGenerators(seed, purpose="Relay", per_episode=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ACTION (*, A), PLAN_STATUS (*, 1) and TURN (*, 1); every input is (*, ...)."""
        batch, n = tensordict.batch_size, tensordict.batch_size.numel()
        turn = self._turns(tensordict)
        flat = tensordict.reshape(n)
        status = torch.full((n, 1), NO_PLANNER, device=turn.device)
        parts, order = [], []
        for number, policy in enumerate((self.first, self.second)):
            rows = torch.nonzero(turn[:, 0] == number)[:, 0]
            if len(rows):
                acted = policy(flat[rows])
                parts.append(acted.get(keys.ACTION))
                order.append(rows)
                if (told := acted.get(keys.PLAN_STATUS, None)) is not None:
                    status[rows] = told
        action = torch.cat(parts)[torch.cat(order).argsort()]
        for key, entry in ((keys.ACTION, action), (keys.PLAN_STATUS, status), (keys.TURN, turn)):
            tensordict.set(key, entry.reshape(*batch, *entry.shape[1:]))
        return tensordict

    def _turns(self, tensordict: TensorDictBase) -> Tensor:
        """(N, 1) number of the policy whose turn it is, 0 or 1."""
        time_left = tensordict.get(keys.TIME_LEFT).reshape(-1, 1)
        elapsed = ((1.0 - time_left) * self.horizon).round()
        steps = [int(rng.integers(self.low, self.high + 1)) for rng in self._generators(tensordict)]
        return (elapsed >= torch.tensor(steps, device=elapsed.device)[:, None]).long()


def _range(steps: int | Sequence[int], horizon: int) -> tuple[int, int]:
    """(low, high) of the steps of the first policy; raises ConfigError where they do not fit an episode."""
    ends = list(steps) if isinstance(steps, Sequence) else [steps, steps]
    whole = all(isinstance(end, int) and not isinstance(end, bool) for end in ends)
    if len(ends) != 2 or not whole or not 0 <= ends[0] <= ends[1] <= horizon:
        raise ConfigError(
            f"steps={steps}: give a whole number, or the least and the most of it, from 0 to "
            f"horizon={horizon}, the steps of an episode."
        )
    return ends[0], ends[1]
