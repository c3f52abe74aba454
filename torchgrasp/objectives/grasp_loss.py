"""What the loss modules share: reading keys, masks, reductions, and modes that reach the networks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.objectives import LossModule

from torchgrasp.errors import ConfigError
from torchgrasp.modules.network import GraspNetwork
from torchgrasp.objectives import functional

# Two (*, D) tensors to their (*) distances.
Distance = Callable[[Tensor, Tensor], Tensor]


class GraspLoss(LossModule):
    """A LossModule whose optional inputs are masks: a mask that a batch lacks is true everywhere."""

    reduction: str
    _selected: list[NestedKey] | None = None

    def __init__(
        self, *, reduction: str | None = None, use_prioritized_weights: bool | Literal["auto"] = "auto"
    ) -> None:
        super().__init__()
        if reduction not in (None, "mean", "sum", "none"):
            raise ConfigError(f"reduction={reduction!r} is unknown: choose 'mean', 'sum' or 'none'.")
        if use_prioritized_weights not in (True, False, "auto"):
            raise ConfigError(
                f"use_prioritized_weights={use_prioritized_weights!r} is unknown: choose True, False or "
                "'auto', the weights where a batch has them."
            )
        self.reduction = "mean" if reduction is None else reduction
        self.use_prioritized_weights = use_prioritized_weights

    def train(self, mode: bool = True) -> GraspLoss:
        """Set the mode of the loss and, unlike LossModule, of its networks."""
        for value in self.__dict__.values():
            if isinstance(value, nn.Module):
                value.train(mode)
        super().train(mode)
        return self

    @property
    def out_keys(self) -> list[NestedKey]:
        """What is written, or the part of it that `select_out_keys` chose."""
        return self._terms() if self._selected is None else self._selected

    @out_keys.setter
    def out_keys(self, value: Sequence[NestedKey]) -> None:
        self._selected = list(value)

    def _terms(self) -> list[NestedKey]:
        raise NotImplementedError

    def _make_vmap(self) -> None:
        """Nothing: no network runs under a vmap of the loss, so each draws random numbers of its own."""

    def _adopt(self, network: Any, name: str, *, with_target: bool = False) -> None:
        """Take over the parameters of a network that reads and writes tensordicts."""
        self.convert_to_functional(network, name, create_target_params=with_target)

    def _key(self, name: str) -> Any:
        return getattr(self.tensor_keys, name)

    def _optional_keys(self, *names: str) -> list[NestedKey]:
        """The keys of these names, and that of the weights where they count."""
        weights = ["priority_weight"] * (self.use_prioritized_weights is not False)
        return [self._key(name) for name in (*names, *weights)]

    def _read(self, tensordict: TensorDictBase, name: str, remedy: str) -> Tensor:
        """The entry that the key `name` stands for, or an error that says what to do."""
        value = tensordict.get(self._key(name), None)
        if value is None:
            raise ConfigError(
                f"{type(self).__name__} needs {self._key(name)!r}, which the batch lacks: "
                f"add it, name another key by set_keys({name}=...), or {remedy}."
            )
        return value

    def _require(self, tensordict: TensorDictBase, keys: Iterable[NestedKey], remedy: str) -> None:
        missing = [key for key in keys if tensordict.get(key, None) is None]
        if missing:
            raise ConfigError(
                f"{type(self).__name__} needs {missing} for its networks, which the batch lacks. {remedy}"
            )

    def _written(
        self, written: TensorDictBase, name: str, remedy: str = "give a network that writes it"
    ) -> Tensor:
        """The output that the key `name` stands for, or an error that says what to do."""
        value = written.get(self._key(name), None)
        if value is None:
            raise ConfigError(
                f"{type(self).__name__} needs {self._key(name)!r}, which its network does not write: "
                f"name the key that it writes by set_keys({name}=...), or {remedy}."
            )
        return value

    def _column(self, value: Tensor, name: str, batch: torch.Size) -> Tensor:
        """(*, 1) values to (*), `batch`; any other shape would broadcast to other samples."""
        if value.shape != (*batch, 1):
            raise ConfigError(
                f"{self._key(name)!r} has the shape {tuple(value.shape)} where the networks write for "
                f"a batch of {tuple(batch)}: give {(*batch, 1)}, by unsqueeze(-1) if the last is absent."
            )
        return value.squeeze(-1)

    def _mask(self, tensordict: TensorDictBase, name: str, batch: torch.Size) -> Tensor | None:
        """The mask (*), true where a batch's entry of any type is not 0; None where the batch has none."""
        mask = tensordict.get(self._key(name), None)
        return None if mask is None else self._column(mask, name, batch).bool()

    def _run(
        self,
        network: TensorDictModuleBase,
        params: TensorDictParams | TensorDictBase,
        inputs: TensorDictBase,
        *,
        keep_statistics: bool = False,
        **part: Any,
    ) -> TensorDictBase:
        """What `network` writes with the given parameters; `inputs` stays as it is.

        With `keep_statistics`, BatchNorm takes its stored statistics and leaves them as they are. `part` are
        options of a GraspNetwork, which leaves the rest out; other networks compute it all.
        """
        self._require(inputs, network.in_keys, "Add them, or give networks with other in_keys.")
        with (
            _stored_statistics(network, keep_statistics),
            params.to_module(network, preserve_module_state=False),
        ):
            return network(
                inputs.select(*network.in_keys), **(part if isinstance(network, GraspNetwork) else {})
            )

    def _writes(self, network: TensorDictModuleBase, name: str) -> bool:
        return unravel_key(self._key(name)) in map(unravel_key, network.out_keys)

    def _reduce(self, values: Tensor, tensordict: TensorDictBase, mask: Tensor | None = None) -> Tensor:
        """(*) values to their mean or sum where they count, or to (*) with zeros elsewhere.

        Weights of prioritised replay and TorchRL's own validity masks count as in every LossModule.
        No branch depends on a mask's values, so that vmap and torch.compile can follow.
        """
        values = values.to(torch.promote_types(values.dtype, torch.float32))  # sums need the digits
        counted = self._counted(values, tensordict, mask)
        weights = self._weights(tensordict, values)
        if self.reduction == "mean":
            return functional.masked_mean(values, counted, weights)
        values = torch.where(counted, values, 0.0)
        values = values if weights is None else values * weights
        return values.sum() if self.reduction == "sum" else values

    def _counted(self, values: Tensor, tensordict: TensorDictBase, mask: Tensor | None) -> Tensor:
        """The (*) mask of what counts: where `mask` is true and TorchRL's validity masks are."""
        counted = self._reduce_loss(torch.ones_like(values), tensordict, reduction="none") > 0
        return counted if mask is None else counted & mask

    def _weights(self, tensordict: TensorDictBase, values: Tensor) -> Tensor | None:
        """Weights (*) of prioritised replay; LossModule's own look-up passes nested keys over."""
        if self.use_prioritized_weights is False:
            return None
        weights = tensordict.get(self._key("priority_weight"), None)
        return None if weights is None else weights.reshape(values.shape)

    def _imitation_term(self, action: Tensor, tensordict: TensorDictBase, distance: Distance) -> Tensor:
        """L_BC where there is an expert's action."""
        expert = self._read(tensordict, "expert_action", "train without imitation (bc_weight=0)")
        mask = self._mask(tensordict, "has_expert", action.shape[:-1])
        values = distance(stand_in(expert, action, mask), action)
        return self._reduce(values, tensordict, mask)

    def _goal_term(
        self, predicted: Tensor, tensordict: TensorDictBase, distance: Distance, *, success_only: bool
    ) -> Tensor:
        """L_AUX where there is a goal, times r_T on demand (Eq. 5).

        Several predictions side by side, of a list of critics, each count.
        """
        goal = self._read(tensordict, "goal", "switch the goal term off by aux_weight=0")
        mask = self._mask(tensordict, "has_goal", predicted.shape[:-1])
        success = None
        if success_only:
            success = self._read(tensordict, "episode_success", "leave Eq. (5) out")
            success = self._column(success, "episode_success", predicted.shape[:-1]).bool()
        each = predicted.unflatten(-1, (-1, goal.shape[-1]))
        goals = goal.unsqueeze(-2).expand_as(each)
        for condition in (mask, success):
            goals = stand_in(goals, each, None if condition is None else condition.unsqueeze(-1))
        values = distance(each, goals).mean(dim=-1)
        if success is not None:
            values = torch.where(success, values, 0.0)
        return self._reduce(values, tensordict, mask)


def stand_in(label: Tensor, predicted: Tensor, mask: Tensor | None) -> Tensor:
    """The (*, D) label where the (*) mask is true, else the prediction, whose distance has no gradient.

    What stands in for an absent label may be NaN, and zero times the gradient at NaN is NaN.
    """
    return label if mask is None else torch.where(mask.unsqueeze(-1), label, predicted.detach())


@contextmanager
def _stored_statistics(network: nn.Module, active: bool) -> Iterator[None]:
    """Have layers with running statistics, those alone, in evaluation mode, if `active`."""
    layers = [m for m in network.modules() if getattr(m, "track_running_stats", False)] if active else []
    layers = [layer for layer in layers if layer.training]
    for layer in layers:
        layer.training = False
    try:
        yield
    finally:
        for layer in layers:
            layer.training = True


def unique_keys(*groups: Iterable[Any]) -> list[NestedKey]:
    """The keys of all groups in order, each once."""
    return list(dict.fromkeys(unravel_key(key) for group in groups for key in group))
