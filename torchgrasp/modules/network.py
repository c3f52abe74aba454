"""What actor, critic and goal predictor are to tensordicts: modules that may be asked for a part."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from tensordict.utils import NestedKey
from torch import Tensor


class GraspNetwork(TensorDictModule):
    """A TensorDictModule whose outputs after the first can be left out: by options of its module.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchgrasp.modules import GraspActor, PointNet
        >>> state = TensorDict({"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1)}, [2])
        >>> actor = GraspActor(PointNet)
        >>> sorted(set(actor(state.copy(), predict_goal=False).keys()) - set(state.keys()))
        ['action']
    """

    @property
    def num_values(self) -> int:
        """How many values it gives, none unless it is a critic."""
        return len(getattr(self.module, "value_heads", ()))

    def _write_to_tensordict(
        self,
        tensordict: TensorDictBase,
        tensors: Sequence[Tensor],
        tensordict_out: TensorDictBase | None = None,
        out_keys: Iterable[NestedKey] | None = None,
    ) -> TensorDictBase:
        """Write what was computed; TensorDictModule's own wants it all, and looks for pandas each time."""
        written = tensordict if tensordict_out is None else tensordict_out
        keys = self.out_keys_source if out_keys is None else out_keys
        for key, value in zip(keys, tensors, strict=False):
            written.set(key, value)
        return written
