"""What the loss modules share: reading keys, masks, reductions, and modes that reach the networks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.objectives import LossModule

from torchgrasp.errors import ConfigError

# Two (*, D) tensors to their (*) distances.
Distance = Callable[[Tensor, Tensor], Tensor]


class GraspLoss(LossModule):
    """A LossModule whose optional inputs are masks: a mask that a batch lacks is true everywhere."""

    reduction: str

    def __init__(self, *, reduction: str = "mean") -> None:
        super().__init__()
        if reduction not in ("mean", "sum", "none"):
            raise ConfigError(f"reduction={reduction!r} is unknown: choose 'mean', 'sum' or 'none'.")
        self.reduction = reduction

    def train(self, mode: bool = True) -> GraspLoss:
        """Set the mode of the loss and, unlike LossModule, of its networks."""
        for value in self.__dict__.values():
            if isinstance(value, nn.Module):
                value.train(mode)
        super().train(mode)
        return self

    def _adopt(self, network: Any, name: str, *, with_target: bool = False) -> None:
        """Take over the parameters of a network that reads and writes tensordicts."""
        self.convert_to_functional(network, name, create_target_params=with_target)

    def _key(self, name: str) -> Any:
        return getattr(self.tensor_keys, name)

    def _read(self, tensordict: TensorDictBase, name: str, remedy: str) -> Tensor:
        """The entry that the key `name` stands for, or an error that says what to do."""
        value = tensordict.get(self._key(name), None)
        if value is None:
            raise ConfigError(
                f"{type(self).__name__} needs {self._key(name)!r}, which the batch lacks: "
                f"add it, name another key by set_keys({name}=...), or {remedy}."
            )
        return value

    def _mask(self, tensordict: TensorDictBase, name: str) -> Tensor | None:
        mask = tensordict.get(self._key(name), None)
        return None if mask is None else mask.squeeze(-1)

    def _run(
        self, network: TensorDictModuleBase, params: TensorDictParams | TensorDictBase, inputs: TensorDictBase
    ) -> TensorDictBase:
        """What `network` writes with the given parameters; `inputs` stays as it is."""
        with params.to_module(network, preserve_module_state=False):
            return network(inputs.select(*network.in_keys, strict=False))

    def _writes(self, network: TensorDictModuleBase, name: str) -> bool:
        return unravel_key(self._key(name)) in map(unravel_key, network.out_keys)

    def _reduce(self, values: Tensor, tensordict: TensorDictBase, mask: Tensor | None = None) -> Tensor:
        """(*) values to their mean or sum where the mask is true, or to (*) with zeros elsewhere.

        Weights of prioritised replay and TorchRL's own validity masks count as in every LossModule.
        """
        weights = self._maybe_get_priority_weight(tensordict)
        if mask is not None and (self.reduction == "none" or not mask.any()):
            values = torch.where(mask, values, 0.0)
            mask = None
        return self._reduce_loss(values, tensordict, mask=mask, weights=weights)

    def _goal_term(
        self, predicted: Tensor, tensordict: TensorDictBase, distance: Distance, *, success_only: bool
    ) -> Tensor:
        """L_AUX where there is a goal, times r_T on demand (Eq. 5).

        Several predictions side by side, of a list of critics, each count.
        """
        goal = self._read(tensordict, "goal", "switch the goal term off by aux_weight=0")
        each = predicted.unflatten(-1, (-1, goal.shape[-1]))
        values = distance(each, goal.unsqueeze(-2).expand_as(each)).mean(dim=-1)
        if success_only:
            success = self._read(tensordict, "episode_success", "leave Eq. (5) out")
            values = values * success.squeeze(-1).to(values.dtype)
        return self._reduce(values, tensordict, self._mask(tensordict, "has_goal"))


def unique_keys(*groups: Iterable[Any]) -> list[NestedKey]:
    """The keys of all groups in order, each once."""
    return list(dict.fromkeys(unravel_key(key) for group in groups for key in group))
