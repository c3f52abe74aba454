"""Losses whose target looks ahead to the next state; one of TorchRL's value estimators computes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.objectives import TD3Loss, ValueEstimators
from torchrl.objectives.utils import dispatch_value_estimator
from torchrl.objectives.value import ValueEstimatorBase

from torchgrasp.errors import ConfigError, UnsupportedError, check_range
from torchgrasp.objectives.grasp_loss import GraspLoss, unique_keys

# Sec. 6.4.
_GAMMA = 0.95
# The key that each key of an estimator takes over from the loss.
_KEYS = {
    "value": "state_action_value",
    "reward": "reward",
    "done": "done",
    "terminated": "terminated",
    "steps_to_next_obs": "steps_to_next_obs",
}


class BootstrappedLoss(GraspLoss):
    """A GraspLoss with a value estimator: TD(0) with the discount 0.95 until another is made.

    The estimator is configuration: no checkpoint holds it, and no change of precision rounds its discount.
    Targets are clipped to `value_limits`, the least and largest value that is possible, where they are given.
    """

    default_value_estimator = ValueEstimators.TD0

    def __init__(self, *, value_limits: Sequence[float] | None = None, **options: Any) -> None:
        super().__init__(**options)
        self.value_limits = _check_limits(value_limits)

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """Choose how the target looks ahead; everything that TorchRL's TD3Loss takes will do.

        Args:
            value_type: TD0, TD1 or TDLambda of ValueEstimators or by name, such as "td0"; or a
                ValueEstimatorBase, or its class. TD0 by default.
            hyperparams: of the estimator. `gamma` is 0.95 where it is not given.

        Raises:
            UnsupportedError: any other estimator.
        """
        if "gamma" in hyperparams:
            check_range("gamma", hyperparams["gamma"], 0.0, 1.0)
        chosen = self.default_value_estimator if value_type is None else value_type
        try:
            if isinstance(chosen, (ValueEstimatorBase, type)):
                given: Any = chosen  # TorchRL names enums alone, and takes classes and objects as well
                super().make_value_estimator(given, **hyperparams)
            else:
                self._make_known_estimator(chosen, {"gamma": _GAMMA, **hyperparams})
        except (NotImplementedError, KeyError, TypeError) as error:
            names = ", ".join(known.name for known in TD3Loss.SUPPORTED_VALUE_ESTIMATORS)
            raise UnsupportedError(
                f"value_type={value_type} with {hyperparams} is not offered: choose one of {names}, and "
                "arguments of TorchRL's estimator of that name."
            ) from error
        # A submodule would be part of the state_dict, and its discount be cast to the networks' type.
        vars(self)["_value_estimator"] = self._modules.pop("_value_estimator")
        return self

    def _make_known_estimator(self, value_type: Any, hyperparams: dict[str, Any]) -> None:
        dispatch_value_estimator(
            self,
            value_type,
            supported=TD3Loss.SUPPORTED_VALUE_ESTIMATORS,
            tensor_keys=self._estimator_keys(),
            value_network=None,
            **{"device": self._default_device, **hyperparams},
        )

    @property
    def gamma(self) -> float:
        """The discount of one step."""
        estimator: Any = self._value_estimator
        return estimator.gamma.item()

    def _estimator_keys(self) -> dict[str, NestedKey]:
        return {name: self._key(ours) for name, ours in _KEYS.items()}

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        if self._value_estimator is not None:
            self._value_estimator.set_keys(**self._estimator_keys())

    def _ahead_keys(self) -> list[NestedKey]:
        """What the target reads beside the next state; the number of steps and `done` may be missing."""
        ends = [("next", self._key(name)) for name in ("reward", "done", "terminated")]
        return unique_keys([self._key("steps_to_next_obs")], ends)

    def _look_ahead(self, tensordict: TensorDictBase, next_value: Tensor) -> Tensor:
        """The target (*, 1), of what followed and the value (*, 1) of the next state.

        Where n steps lie between a state and its next one, as MultiStep counts them, the value counts
        gamma^n.
        """
        batch = next_value.shape[:-1]
        reward, terminated = (
            self._column(
                self._read(tensordict.get("next"), name, "record transitions with it below 'next'"),
                name,
                batch,
            ).unsqueeze(-1)
            for name in ("reward", "terminated")
        )
        terminated = terminated.bool()
        ahead = tensordict.select(*self._ahead_keys(), strict=False)
        done = ahead.get(("next", self._key("done")), terminated)
        for name, value in (("reward", reward), ("terminated", terminated), ("done", done.bool())):
            ahead.set(unravel_key(("next", self._key(name))), value)
        # 0 times NaN is NaN: what follows an end may be anything.
        next_value = torch.where(terminated, 0.0, next_value)
        target = self.value_estimator.value_estimate(ahead, next_value=next_value)
        return target if self.value_limits is None else target.clamp(*self.value_limits)


def _check_limits(value_limits: Any) -> tuple[float, float] | None:
    if value_limits is None:
        return None
    try:
        low, high = map(float, value_limits)
    except (TypeError, ValueError):
        low, high = 0.0, 0.0
    if isinstance(value_limits, str) or not low < high:
        raise ConfigError(f"value_limits={value_limits}: give the least and the largest value, as in (0, 1).")
    return low, high
