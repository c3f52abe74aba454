"""What the transforms share: where they are called, numpy at their core, randomness of a world's own."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import ClassVar, Literal

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.intrinsics import CameraIntrinsics
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
        per_episode: whether a draw holds for a whole episode rather than for one step.

    Attributes:
        simulates_sensor: whether it stands for an error that a real sensor has by itself.
    """

    simulates_sensor: ClassVar[bool] = False

    def __init__(self, *, in_keys: list, out_keys: list, seed: int = 0, per_episode: bool = False) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        # Two of one class that read different cameras draw different numbers.
        overhead = any(key == keys.T_BASE_OVERHEAD or key[0] == "overhead" for key in in_keys)
        purpose = type(self).__name__ + (" overhead" if overhead else "")
        self._generators = MomentGenerators(seed, purpose=purpose, per_episode=per_episode)

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


def find_container(transform: Transform) -> EnvBase | None:
    """The environment that a transform is in, or None."""
    try:
        return transform.container
    except ValueError:  # TorchRL's answer to a Compose that is in none
        return None


CameraName = Literal["wrist", "overhead"]


def camera_keys(name: CameraName) -> keys.CameraKeys:
    """Keys of the wrist camera or of the static one."""
    if name not in ("wrist", "overhead"):
        raise ConfigError(f"camera={name!r} of a transform is unknown: give wrist or overhead.")
    return keys.WRIST if name == "wrist" else keys.OVERHEAD


def choose_intrinsics(
    intrinsics: CameraIntrinsics | None, fov: float | None, height: int, width: int
) -> CameraIntrinsics:
    """The camera of a picture of that size: as given, or by its vertical field of view (radians; 90 degrees).

    Raises:
        ConfigError: where the picture is of another size than the camera's.
    """
    if intrinsics is None:
        return _by_view(width, height, math.pi / 2 if fov is None else fov)
    if (intrinsics.height, intrinsics.width) != (height, width):
        raise ConfigError(
            f"A picture of {width} x {height} pixels does not belong to intrinsics of {intrinsics.width} x "
            f"{intrinsics.height}: give those of the pictures, since the focal length counts in their pixels."
        )
    return intrinsics


@functools.lru_cache(maxsize=16)
def _by_view(width: int, height: int, fov: float) -> CameraIntrinsics:
    """Kept, with the rays that it is asked for: transforms choose it anew for every picture."""
    return CameraIntrinsics(width, height, fov=fov)


def check_lens(intrinsics: CameraIntrinsics | None, fov: float | None) -> None:
    """Raise ConfigError where both are given, or a field of view that no pinhole camera has."""
    if fov is not None:
        check_range("fov", fov, 0.0, math.pi * 0.95, open_low=True)
        if intrinsics is not None:
            raise ConfigError(f"fov={fov} and intrinsics are both given: give one of them.")


# Clouds are of another size in every world, so that their rows are handled one by one: there numpy takes
# a fraction of the time that torch takes for its many small operations.
def read_rows(tensordict: TensorDictBase, *names: NestedKey) -> list[np.ndarray]:
    """(B, ...) arrays of the named entries, the batch dimensions made one; not to be written to."""
    batch_dims = tensordict.batch_dims
    tensors: Iterable[Tensor] = (tensordict.get(name) for name in names)
    return [each.detach().reshape(-1, *each.shape[batch_dims:]).cpu().numpy() for each in tensors]


def write_rows(tensordict: TensorDictBase, name: NestedKey, rows: np.ndarray) -> None:
    """Set an entry from its (B, ...) rows, in the batch shape and on the device of the tensordict."""
    tensor = torch.from_numpy(rows).reshape(*tensordict.batch_size, *rows.shape[1:])
    tensordict.set(name, tensor if tensordict.device is None else tensor.to(tensordict.device))


def check_is_cloud(name: str, points: np.ndarray) -> None:
    """Raise ConfigError where the gripper's points and the flag channel are in POINTS already."""
    if points.shape[-1] != 3:
        raise ConfigError(
            f"{name} was given points of {points.shape[-1]} channels instead of xyz: "
            "put it before AppendGripperPoints."
        )


def pad_clouds(clouds: Sequence[np.ndarray], width: int) -> np.ndarray:
    """Clouds (n_i, 3) to (B, width, 3), zeros behind."""
    out = np.zeros((len(clouds), width, 3), dtype=np.float32)
    for row, cloud in zip(out, clouds, strict=True):
        row[: len(cloud)] = cloud
    return out


def write_clouds(tensordict: TensorDictBase, points: np.ndarray, counts: Sequence[int]) -> None:
    """Set POINTS from (B, N, 3) rows and NUM_POINTS from how many of each are points."""
    write_rows(tensordict, keys.POINTS, points)
    write_rows(tensordict, keys.NUM_POINTS, np.array(counts, dtype=np.int64)[:, None])
