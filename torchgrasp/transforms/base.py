"""What the point transforms share: where they are called, and randomness that belongs to a world."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform

from torchgrasp.randomness import MomentGenerators


class PointTransform(Transform):
    """A transform from some keys of one tensordict to others, with any batch shape.

    Subclasses write `_call`, and `_out_shapes` where a key appears or changes its shape. In an
    environment `_call` sees the observations of reset and step; in a buffer and on a bare tensordict
    it sees the tensordict and, where there is one, its "next".

    Args:
        in_keys: what is read.
        out_keys: what is written.
        seed: of the transform's own randomness.
    """

    def __init__(self, *, in_keys: list, out_keys: list, seed: int = 0) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self._generators = MomentGenerators(seed, purpose=type(self).__name__)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Transform the tensordict and, where there is one, its "next"."""
        tensordict = self._call(tensordict)
        if (after := tensordict.get("next", None)) is not None and self.in_keys[0] in after.keys(True):
            tensordict.set("next", self._call(after))
        return tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def _out_shapes(self, observation_spec: Composite) -> dict:
        """Shape and dtype of each key written, (shape after the batch, dtype)."""
        return {}

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the keys that are written."""
        batch, device = observation_spec.shape, observation_spec.device
        for key, (shape, dtype) in self._out_shapes(observation_spec).items():
            observation_spec[key] = Unbounded(batch + tuple(shape), dtype=dtype, device=device)
        return observation_spec


def flat_batch(tensor: Tensor, tensordict: TensorDictBase) -> Tensor:
    """The tensor with its batch dimensions made one."""
    return tensor.reshape(-1, *tensor.shape[tensordict.batch_dims :])


def pad_clouds(clouds: list[Tensor], width: int) -> tuple[Tensor, Tensor]:
    """Clouds (n_i, 3) to (B, width, 3), zeros behind, and their (B, 1) numbers of points."""
    out = clouds[0].new_zeros(len(clouds), width, 3)
    for row, cloud in zip(out, clouds, strict=True):
        row[: len(cloud)] = cloud
    return out, torch.tensor([[len(cloud)] for cloud in clouds])
