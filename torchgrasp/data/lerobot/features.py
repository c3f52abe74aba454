"""Columns of demonstrations as features of a LeRobotDataset: their names, types and shapes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

import torch
from pydantic import Field
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.data.sampler import STUB
from torchgrasp.documents import Document
from torchgrasp.errors import ConfigError

_IMAGES = "observation.images."
# Where a column stands in a LeRobotDataset. Policies of LeRobot read `observation.*`, and predict `action*`.
NAMES: dict[NestedKey, str] = {
    keys.JOINTS: "observation.state",
    **{
        key: f"observation.{key}"
        for key in (
            *(keys.T_BASE_EE, keys.T_BASE_CAMERA, keys.T_BASE_OVERHEAD, keys.JOINT_VELOCITIES),
            *(keys.TIME_LEFT, keys.POINTS, keys.NUM_POINTS, keys.TABLE_PLANE, keys.WRIST_ANGLE),
        )
    },
    **{key: _IMAGES + key[-1] for key in (keys.DEPTH, keys.MASK, keys.RGB)},
    **{key: _IMAGES + "_".join(key) for key in (keys.OVERHEAD_DEPTH, keys.OVERHEAD_MASK, keys.OVERHEAD_RGB)},
    **{key: f"next.{key}" for key in ("reward", "terminated", "done")},
}
KEYS = {name: key for key, name in NAMES.items()}
# What LeRobot counts itself, in every dataset.
COUNTERS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
_RESERVED = {*COUNTERS, "task"}
_AXES: dict[NestedKey, list[str]] = {
    keys.JOINTS: [*(f"panda_joint{number}" for number in range(1, 8)), "finger_1", "finger_2"],
    keys.ACTION: ["x", "y", "z", "rx", "ry", "rz"],
}
PictureKind = Literal["depth", "mask", "rgb"]
# Half floats become floats, which hold them exactly and which every reader of parquet knows.
_STORED = {"float16": "float32", "bfloat16": "float32"}
NumberType = Literal[
    "float16", "bfloat16", "float32", "float64", "bool", "uint8", "int8", "int16", "int32", "int64"
]
_MOST_AXES = 5
# Numbers of one frame: a picture of 4,096 x 4,096.
_MOST_NUMBERS = 1 << 24


# A column's key becomes the name of a file.
KeyPart = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=100)]


class Column(Document):
    """What a column of demonstrations is, as meta/torchgrasp.json tells it of each feature."""

    key: Annotated[list[KeyPart], Field(min_length=1, max_length=16)]
    dtype: NumberType
    shape: Annotated[list[Annotated[int, Field(ge=0, le=_MOST_NUMBERS)]], Field(max_length=_MOST_AXES)]


@dataclass(frozen=True)
class Feature:
    """A feature of a LeRobotDataset that holds a column.

    Attributes:
        name: in the dataset.
        key: of the column.
        dtype: of the column.
        shape: of a frame's entry in the column.
        picture: which kind of picture it is stored as; None for numbers.
    """

    name: str
    key: NestedKey
    dtype: torch.dtype
    shape: tuple[int, ...]
    picture: PictureKind | None = None

    @property
    def stored(self) -> str:
        """The type of its numbers in the files."""
        name = str(self.dtype).removeprefix("torch.")
        return _STORED.get(name, name)

    @property
    def bytes(self) -> int:
        """Of a frame's entry in memory."""
        return math.prod(self.shape) * self.dtype.itemsize

    def describe(self) -> dict[str, Any]:
        """Its entry in meta/info.json."""
        if self.picture is not None:
            shape = [*self.shape[:2], 3 if self.picture == "rgb" else 1]
            names = ["height", "width", "channels"]
            depth = {"is_depth_map": True, "depth_unit": "m"} if self.picture == "depth" else {}
            return {"dtype": "image", "shape": shape, "names": names, **({"info": depth} if depth else {})}
        names = _AXES.get(self.key)
        names = names if names is not None and self.shape == (len(names),) else None
        return {"dtype": self.stored, "shape": list(self.shape) or [1], "names": names}

    def tell(self) -> dict[str, Any]:
        """Its entry in meta/torchgrasp.json, a `Column`."""
        key = [self.key] if isinstance(self.key, str) else list(self.key)
        return {"key": key, "dtype": str(self.dtype).removeprefix("torch."), "shape": list(self.shape)}


def find_features(rows: TensorDictBase) -> list[Feature]:
    """A feature for each column of encoded rows (R) but the marks of stubs, in order of their names."""
    features = [_find_feature(key, rows[key]) for key in rows.keys(True, True) if key != STUB]
    return sorted(features, key=lambda feature: feature.name)


def _find_feature(key: NestedKey, values: Tensor) -> Feature:
    parts = (key,) if isinstance(key, str) else tuple(map(str, key))
    name = NAMES.get(key, ".".join(parts))
    name = f"torchgrasp.{name}" if name in _RESERVED or (name in KEYS and key not in NAMES) else name
    shape = tuple(values.shape[1:])
    if (
        str(values.dtype).removeprefix("torch.") not in get_args(NumberType)
        or len(shape) > _MOST_AXES
        or "/" in name
    ):
        raise ConfigError(
            f"The column {key!r} of {values.dtype} and shape {shape} fits into no LeRobotDataset: leave it "
            f"out of what is collected, or give numbers of up to {_MOST_AXES} axes and a name without /."
        )
    return Feature(name, key, values.dtype, shape, _find_picture(key, values.dtype, shape))


def _find_picture(key: NestedKey, dtype: torch.dtype, shape: tuple[int, ...]) -> PictureKind | None:
    """Which picture a camera's column is, where it has the type and shape of one."""
    kinds: dict[PictureKind, tuple[torch.dtype, int]] = {
        "depth": (torch.float32, 2),
        "mask": (torch.bool, 2),
        "rgb": (torch.uint8, 3),
    }
    name = NAMES.get(key, "")
    for kind, (expected, axes) in kinds.items():
        fits = dtype == expected and len(shape) == axes and 0 not in shape
        if name.startswith(_IMAGES) and key[-1] == kind and fits and (kind != "rgb" or shape[2] == 3):
            return kind
    return None


def recall_feature(name: str, column: Column) -> Feature:
    """The feature of an export that `column` tells of."""
    key = column.key[0] if len(column.key) == 1 else tuple(column.key)
    dtype, shape = getattr(torch, column.dtype), tuple(column.shape)
    return Feature(name, key, dtype, shape, _find_picture(key, dtype, shape))


def check_sizes(features: Sequence[Feature], source: object, remedy: str) -> None:
    """ConfigError where a frame would take more memory than any camera's does."""
    for feature in features:
        if math.prod(feature.shape) > _MOST_NUMBERS:
            raise ConfigError(
                f"{source} tells of {feature.name!r} of shape {feature.shape}, more than {_MOST_NUMBERS} "
                f"numbers a frame: {remedy}."
            )
