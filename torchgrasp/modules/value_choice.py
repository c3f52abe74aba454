"""Acting by the best of several actions in a critic's eyes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.modules.action_limits import find_limits


class ValueChoice(TensorDictModuleBase):
    """Replaces the action (*, A) of a policy by a better one nearby, where a critic is sure of it.

    The critic is asked about the policy's action, about actions that the policy wrote beside it, such as
    that of a residual's base policy (EXPO, arXiv 2507.07986), and about `num_nearby` others within `reach`.
    The best of them is taken if its value is at least `margin` above that of the policy's own. A critic
    that is only asked to choose cannot be climbed to where it knows nothing, unlike one whose gradient
    trains an actor (Grasp-MPC, arXiv 2509.06201).

    The actions nearby are the same at each call, spread evenly (Sobol), so that the policy is
    deterministic as long as both networks are: put it in evaluation mode. Of several values side by side
    the `statistic` counts.

    Args:
        policy: reads the state, writes the action.
        critic: reads state and action, writes values side by side (*, Q), such as a GraspCritic.
        num_nearby: how many other actions near the policy's are tried.
        reach: how far they are from it, in each component at most, as a share of the half range; a number,
            or one for each component.
        margin: least gain in value for which the action is replaced.
        statistic: 'min' or 'mean' of the values side by side.
        other_keys: actions that the policy writes besides its own and that are tried too.
        action_bound: largest magnitude of each component of the action.
        action_spec: instead of it, the action's Bounded spec, or a Composite that holds it.
        action_key: of the action.
        value_key: of the critic's values; the value of the action that is taken is written there, (*, 1).
        seed: of the actions nearby.

    Raises:
        ConfigError: for keys that policy or critic do not read or write, and limits that are missing.

    Example:
        >>> from tensordict.nn import TensorDictModule
        >>> policy = TensorDictModule(lambda angle: torch.zeros_like(angle), ["angle"], ["action"])
        >>> critic = TensorDictModule(
        ...     lambda angle, action: -(action - 1.0).abs(), ["angle", "action"], ["state_action_value"]
        ... )
        >>> choice = ValueChoice(policy, critic, num_nearby=64, reach=0.2, action_bound=[2.0])
        >>> state = TensorDict({"angle": torch.zeros(3, 1)}, [3])
        >>> bool((choice(state)["action"] > 0.35).all())  # of those up to 0.4
        True
    """

    offsets: Tensor
    low: Tensor
    high: Tensor

    def __init__(
        self,
        policy: TensorDictModuleBase,
        critic: TensorDictModuleBase,
        *,
        num_nearby: int = 32,
        reach: float | Sequence[float] = 0.1,
        margin: float = 0.0,
        statistic: Literal["min", "mean"] = "min",
        other_keys: Sequence[NestedKey] = (),
        action_bound: Sequence[float] | None = None,
        action_spec: Any = None,
        action_key: NestedKey = keys.ACTION,
        value_key: NestedKey = keys.STATE_ACTION_VALUE,
        seed: int = 0,
    ) -> None:
        super().__init__()
        check_whole("num_nearby", num_nearby, 0)
        check_range("margin", margin, 0.0, float("inf"))
        self.policy, self.critic = policy, critic
        self.margin, self.statistic = margin, statistic
        self.action_key, self.value_key = unravel_key(action_key), unravel_key(value_key)
        self._others = [unravel_key(key) for key in other_keys]
        _check_keys(policy, critic, action_key, value_key, other_keys)
        if statistic not in ("min", "mean"):
            raise ConfigError(f"statistic={statistic!r} is unknown: choose 'min' or 'mean'.")
        low, high = find_limits(action_bound, action_spec, action_key)
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("high", high, persistent=False)
        sobol = SobolEngine(len(low), scramble=True, seed=seed)
        unit = 2.0 * sobol.draw(max(1, num_nearby))[:num_nearby] - 1.0  # it draws no fewer than one
        offsets = unit * _check_reach(reach, len(low)) * (high - low) / 2
        self.register_buffer("offsets", offsets, persistent=False)
        state = [key for key in map(unravel_key, critic.in_keys) if key != self.action_key]
        made = set(map(unravel_key, policy.out_keys))
        read = [*map(unravel_key, policy.in_keys), *(key for key in state if key not in made)]
        self._state = state
        self.in_keys = list(dict.fromkeys(read))  # pyright: ignore[reportAttributeAccessIssue]
        written = [*map(unravel_key, policy.out_keys), self.value_key]
        self.out_keys = list(dict.fromkeys(written))  # pyright: ignore[reportAttributeAccessIssue]

    @dispatch()
    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action that is taken, its value, and what else the policy writes."""
        tensordict = self.policy(tensordict)
        tried = self._list_actions(tensordict)  # (*, K, A), the policy's own first
        value = self._judge(tensordict, tried)  # (*, K)
        best = value.argmax(dim=-1, keepdim=True)
        gain = value.gather(-1, best) - value[..., :1]
        best = torch.where(gain >= self.margin, best, torch.zeros_like(best))
        action = tried.gather(-2, best.unsqueeze(-1).expand(*best.shape, tried.shape[-1])).squeeze(-2)
        return tensordict.set(self.action_key, action).set(self.value_key, value.gather(-1, best))

    def _list_actions(self, tensordict: TensorDictBase) -> Tensor:
        own = tensordict.get(self.action_key).unsqueeze(-2)
        others = [tensordict.get(key).unsqueeze(-2) for key in self._others]
        nearby = (own + self.offsets.to(own)).clamp(self.low.to(own), self.high.to(own))
        return torch.cat((own, *others, nearby), dim=-2)

    def _judge(self, tensordict: TensorDictBase, tried: Tensor) -> Tensor:
        """The value (*, K) of each of the actions (*, K, A)."""
        *batch, count, _ = tried.shape
        state = tensordict.select(*self._state)
        inputs = TensorDict(
            {key: _repeat(value, len(batch), count) for key, value in state.items(True, True)},
            [*batch, count],
            device=tensordict.device,
        )
        values = self.critic(inputs.set(self.action_key, tried)).get(self.value_key)
        return values.amin(dim=-1) if self.statistic == "min" else values.mean(dim=-1)


def _repeat(value: Tensor, dim: int, count: int) -> Tensor:
    """A value (*, ...) for each of `count` actions (*, count, ...), without a copy."""
    return value.unsqueeze(dim).expand(*value.shape[:dim], count, *value.shape[dim:])


def _check_reach(reach: Any, size: int) -> Tensor:
    """The reach as a share of the half range, () or (size,)."""
    if isinstance(reach, Sequence) and len(reach) != size:
        raise ConfigError(f"reach={list(reach)}: give a number, or one for each of the {size} components.")
    for each in reach if isinstance(reach, Sequence) else [reach]:
        check_range("reach", each, 0.0, 1.0)
    return torch.tensor(reach)


def _check_keys(policy: Any, critic: Any, action_key: Any, value_key: Any, other_keys: Any) -> None:
    """Refuse a policy that does not write the actions, and a critic that does not judge them."""
    if isinstance(other_keys, str):
        raise ConfigError(f"other_keys={other_keys!r}: give a list of keys.")
    written, judged = set(map(unravel_key, policy.out_keys)), set(map(unravel_key, critic.in_keys))
    if absent := [key for key in (action_key, *other_keys) if unravel_key(key) not in written]:
        raise ConfigError(f"policy writes {policy.out_keys} and no {absent}: name its actions' own keys.")
    if unravel_key(action_key) not in judged:
        raise ConfigError(
            f"critic reads {critic.in_keys} and no {action_key!r}: give one that judges actions."
        )
    if unravel_key(value_key) not in set(map(unravel_key, critic.out_keys)):
        raise ConfigError(
            f"critic writes {critic.out_keys} and no {value_key!r}: name its values by value_key."
        )
