"""A residual policy: what a given policy does, and a bounded correction that is learned."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential, dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.modules.action_limits import find_limits
from torchgrasp.modules.layers import mlp
from torchgrasp.modules.split import split_network

# Where the encoder that actor and correction share writes its feature.
ACTOR_FEATURE = (keys.FEATURES, "actor")


class ResidualActor(TensorDictModuleBase):
    """Writes the action (*, A) of a frozen base policy plus a correction, which is zero at the start.

    With the limits' half range h, componentwise,

        action = clip(base action + scale h tanh(correction(inputs, base action / h)), limits).

    The base policy never changes, so that values of its own episodes stay true, and no update can move an
    action further than `scale` from what the base policy does within the limits. Residual policies are of
    Silver et al. 2018 (arXiv 1812.06298) and Johannink et al. 2019 (arXiv 1812.03201); the bound is Policy
    Decorator's (Yuan et al. 2024, arXiv 2412.13630). Nothing here is about grasping.

    Losses take it as any actor: gradients reach the correction alone. What the base policy writes
    besides the action, such as a goal prediction, is written as it is.

    Args:
        base: the policy, which writes the action within the limits. A module is copied, as its other owners
            go on training theirs, then frozen and kept in evaluation mode.
        correction: called as ``correction(*values, base_action)`` with the values (*, D) of `in_keys` and the
            base action (*, A) in units of the half range about the limits' middle; gives (*, A) numbers.
            TorchRL's MLP joins what it is given. Its linear layer that was registered last is set to zero.
        scale: the largest correction, as a share of the half range: 0.03 to 0.3 in Policy Decorator.
        in_keys: what the correction reads besides the base action: observations, or what the base policy
            writes, such as the feature of an encoder that both share.
        action_bound: largest magnitude of each component of the action.
        action_spec: instead of it, the action's Bounded spec, or a Composite that holds it.
        action_key: of the action.
        base_action_key: where the base policy's action is written.
        copy_base: False to take the base policy itself, frozen from now on.
        where: called with the values of `in_keys`; gives (*, 1) bool, where there is a correction at all.
            Everywhere if None.

    Raises:
        ConfigError: for a base policy that writes no such action, a correction without a linear layer at its
            end, and limits that are missing or infinite.

    Example:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from torchrl.modules import MLP
        >>> base = TensorDictModule(lambda angle: -0.5 * angle, ["angle"], ["action"])
        >>> actor = ResidualActor(base, MLP(3, 1), in_keys=["angle", "rate"], action_bound=[2.0])
        >>> state = TensorDict({"angle": torch.ones(4, 1), "rate": torch.zeros(4, 1)}, [4])
        >>> actor(state)["action"].flatten().tolist()
        [-0.5, -0.5, -0.5, -0.5]
    """

    low: Tensor
    high: Tensor
    base: TensorDictModuleBase

    def __init__(
        self,
        base: TensorDictModuleBase,
        correction: nn.Module,
        *,
        scale: float = 0.1,
        in_keys: Sequence[NestedKey] = (),
        action_bound: Sequence[float] | None = None,
        action_spec: Any = None,
        action_key: NestedKey = keys.ACTION,
        base_action_key: NestedKey = keys.BASE_ACTION,
        copy_base: bool = True,
        where: Callable[..., Tensor] | None = None,
    ) -> None:
        super().__init__()
        check_range("scale", scale, 0.0, 1.0)
        if isinstance(in_keys, str):
            raise ConfigError(f"in_keys={in_keys!r}: give a list of keys.")
        written = [unravel_key(key) for key in base.out_keys]
        if unravel_key(base_action_key) in written:
            raise ConfigError(
                f"base_action_key={base_action_key!r} is written by the base policy: give another key."
            )
        if unravel_key(action_key) not in written:
            raise ConfigError(
                f"base writes {written} and no {action_key!r}: give a policy that does, or name its action "
                "by action_key."
            )
        self.base = deepcopy(base) if copy_base else base
        self.base.requires_grad_(False).eval()
        self.correction = correction
        _start_at_zero(correction)
        self.where = where
        self.scale, self.action_key, self.base_action_key = scale, action_key, base_action_key
        self._read = [unravel_key(key) for key in in_keys]
        low, high = find_limits(action_bound, action_spec, action_key)
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("high", high, persistent=False)
        observed = [key for key in self._read if key not in written]
        self.in_keys = list(dict.fromkeys([*map(unravel_key, base.in_keys), *observed]))  # pyright: ignore
        self.out_keys = [*written, unravel_key(base_action_key)]  # pyright: ignore

    def train(self, mode: bool = True) -> ResidualActor:
        """Set the mode of the correction; the base policy stays in evaluation mode."""
        super().train(mode)
        self.base.eval()
        return self

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, the base policy's own, and what else the base policy writes."""
        with torch.no_grad():
            written = self.base(tensordict.select(*self.base.in_keys))
        based = written.get(self.action_key)
        low, high = self.low.to(based), self.high.to(based)
        half, middle = (high - low) / 2, (high + low) / 2
        inputs = [tensordict.get(key) if key in self.in_keys else written.get(key) for key in self._read]
        if low.shape != based.shape[-1:]:
            raise ConfigError(
                f"the limits have {low.numel()} components and the action {based.shape[-1]}: "
                "give action_bound or action_spec of the action's size."
            )
        unit = torch.where(half > 0, half, 1.0)  # of a component that cannot move
        correction = self.correction(*inputs, (based - middle) / unit)
        if correction.shape != based.shape:
            raise ConfigError(
                f"correction gives {tuple(correction.shape)} for actions {tuple(based.shape)}: give a "
                "network with one output a component."
            )
        change = self.scale * half * correction.tanh()
        if self.where is not None:
            change = torch.where(self.where(*inputs), change, 0.0)
        action = (based + change).clamp(low, high)
        for key in self.out_keys[:-1]:
            tensordict.set(key, written.get(key))
        return tensordict.set(self.base_action_key, based).set(self.action_key, action)


class _Joined(nn.Module):
    """A network of what it is given, side by side."""

    def __init__(self, network: nn.Sequential) -> None:
        super().__init__()
        self.network = network

    def forward(self, *values: Tensor) -> Tensor:
        return self.network(torch.cat([value.to(values[-1].dtype) for value in values], dim=-1))


@dataclass(frozen=True)
class _AtTheEnd:
    """Where no more than a share `left` of the episode is left."""

    left: float

    def __call__(self, feature: Tensor, time_left: Tensor, *_: Tensor) -> Tensor:
        return time_left < self.left


def _find_end(last_steps: int | None, horizon: int | None) -> _AtTheEnd | None:
    """Where the last steps are; None for all."""
    if last_steps is None:
        return None
    if horizon is None:
        raise ConfigError(f"last_steps={last_steps} without horizon: give the environment's too.")
    check_whole("horizon", horizon, 1)
    check_whole("last_steps", last_steps, 1, horizon)
    return _AtTheEnd((last_steps + 0.5) / horizon)


class ResidualPolicy(TensorDictSequential):
    """A trained GraspActor, frozen, and a ResidualActor on the feature of its encoder.

    The encoder looks at a state once; actor and correction read what it writes, and so may a critic
    (``GraspCritic(GivenFeature(size), fusion="late", in_keys=[ACTOR_FEATURE, ...])``). Features of a
    frozen encoder can be kept in the replay buffer, so that an update learns on vectors alone.

    Args:
        actor: is frozen from now on, and taken as it is.
        scale: the largest correction, as a share of the action's bound.
        hidden: width of the correction's two hidden layers, which LayerNorm follows.
        last_steps: how many steps at the end of an episode are corrected; all if None. What the hand does
            before, a policy in closed loop undoes.
        horizon: T of the environment, by which the last steps are told.

    Raises:
        ConfigError: for networks without an encoder, or that do not act, and last steps without a horizon.

    Attributes:
        feature_size: of the encoder.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchgrasp.modules import GraspActor, PointNet
        >>> actor = GraspActor(PointNet)
        >>> state = TensorDict({"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1)}, [2])
        >>> policy = ResidualPolicy(actor, scale=0.2)
        >>> torch.equal(policy(state.copy())["action"], actor(state.copy())["action"])
        True
    """

    feature_size: int

    @property
    def encoder(self) -> TensorDictModule:
        """Writes the feature of a state at ACTOR_FEATURE."""
        return cast(TensorDictModule, self[0])

    @property
    def residual(self) -> ResidualActor:
        """Reads it."""
        return cast(ResidualActor, self[1])

    @staticmethod
    def find_corrected(states: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Of the state of such a policy, that of the actor which it corrects."""
        encoder, rest = "module.0.", "module.1.base."
        return {
            key.removeprefix(encoder).removeprefix(rest): value
            for key, value in states.items()
            if key.startswith((encoder, rest))
        }

    def select_subsequence(self, *args: Any, **options: Any) -> TensorDictSequential:
        """A part of it, which is any sequence of modules."""
        parts: list = [self.encoder, self.residual]
        return TensorDictSequential(*parts).select_subsequence(*args, **options)

    def __init__(
        self,
        actor: TensorDictModuleBase,
        *,
        scale: float = 0.2,
        hidden: int = 256,
        last_steps: int | None = None,
        horizon: int | None = None,
    ) -> None:
        check_whole("hidden", hidden, 1)
        encoder, rest = split_network(actor, ACTOR_FEATURE)
        network: Any = rest.module
        if not hasattr(network, "action_head"):
            raise ConfigError(f"actor writes {rest.out_keys} and no action: give a GraspActor.")
        encoder.module.freeze()
        size, num_actions = network.action_head[0].in_features, len(network.limits)
        residual = ResidualActor(
            rest,
            _Joined(mlp([size + num_actions, hidden, hidden, num_actions], norm="layer")),
            scale=scale,
            in_keys=rest.in_keys,
            action_bound=network.limits,
            copy_base=False,
            where=_find_end(last_steps, horizon),
        )
        modules: list = [encoder, residual]
        super().__init__(*modules)
        self.feature_size = network.encoder.out_features


def _start_at_zero(network: nn.Module) -> None:
    """Zero the last layer that has parameters."""
    layers = [each for each in network.modules() if any(True for _ in each.parameters(recurse=False))]
    if not layers or not isinstance(layers[-1], nn.Linear):
        last = type(layers[-1]).__name__ if layers else "no layer that learns"
        raise ConfigError(
            f"correction ends with {last}: give a network whose last layer with weights is linear, such as "
            "TorchRL's MLP, so that the correction can start at zero."
        )
    if isinstance(layers[-1].weight, nn.UninitializedParameter):
        raise ConfigError("correction has a lazy layer at its end: give the number of its inputs.")
    nn.init.zeros_(layers[-1].weight)
    if layers[-1].bias is not None:
        nn.init.zeros_(layers[-1].bias)
