"""What is taken of a LeRobotDataset that others wrote, by the names of its features, and rows of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDict
from torch import Tensor

from torchgrasp import keys
from torchgrasp.data.compact import CompactTransitions, default_labels
from torchgrasp.data.foreign_columns import check_end, read_column
from torchgrasp.data.lerobot.dataset_files import FeatureInfo, Info
from torchgrasp.data.lerobot.episode_frames import Frames
from torchgrasp.data.lerobot.features import NAMES, Feature, PictureKind, check_sizes
from torchgrasp.data.sampler import STUB
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_SIZE

_REWARD, _SUCCESS, _DONE, _TRUNCATED = "next.reward", "next.success", "next.done", "next.truncated"
_PICTURES: dict[NestedKey, PictureKind] = {
    keys.DEPTH: "depth",
    keys.MASK: "mask",
    keys.RGB: "rgb",
    keys.OVERHEAD_DEPTH: "depth",
    keys.OVERHEAD_MASK: "mask",
    keys.OVERHEAD_RGB: "rgb",
}
# Large, and of use to policies alone that were made to read them.
_ASKED = {keys.RGB, keys.OVERHEAD_DEPTH, keys.OVERHEAD_MASK, keys.OVERHEAD_RGB}
_PICTURE_TYPES = {"depth": torch.float32, "mask": torch.bool, "rgb": torch.uint8}
# Shapes that the keys tell; others may have any.
_SHAPES: dict[NestedKey, tuple[int, ...]] = {
    keys.JOINTS: (9,),
    keys.JOINT_VELOCITIES: (9,),
    **dict.fromkeys((keys.T_BASE_EE, keys.T_BASE_CAMERA, keys.T_BASE_OVERHEAD), (4, 4)),
    **dict.fromkeys((keys.TIME_LEFT, keys.NUM_POINTS, keys.WRIST_ANGLE), (1,)),
    keys.TABLE_PLANE: (4,),
    keys.ACTION: (ACTION_SIZE,),
}


@dataclass(frozen=True)
class Taken:
    """Features of others' dataset that become columns.

    Attributes:
        columns: key -> feature.
        outcomes: reward, success and ends, by their names.
        units: of depth, by the feature's name.
    """

    columns: dict[NestedKey, Feature]
    outcomes: dict[str, Feature]
    units: dict[str, str]

    @property
    def features(self) -> list[Feature]:
        """All of them."""
        return [*self.columns.values(), *self.outcomes.values()]


def choose_features(info: Info, codec: CompactTransitions) -> Taken:
    """The features that demonstrations can use; ConfigError names those that they need and are not there."""
    wanted = {keys.ACTION: "action", **NAMES, **{key: key for key in default_labels()}}
    wanted |= {key: NAMES.get(key, str(key)) for key in codec.observation_keys}
    needed = {keys.ACTION, *codec.observation_keys} - {keys.TIME_LEFT}
    lacking = [wanted[key] for key in needed if wanted[key] not in info.features]
    lacking += [] if {_REWARD, _SUCCESS} & info.features.keys() else [_REWARD]
    if lacking:
        raise ConfigError(
            f"The dataset has no {sorted(lacking)}, which demonstrations need, only "
            f"{sorted(info.features)}: name its features so. Clouds in the hand's frame come of depth, mask "
            "and poses by DepthToPoints; or import these by codec=CompactTransitions(points_key=None, ...)."
        )
    taken = Taken({}, {}, {})
    for key, name in wanted.items():
        told = info.features.get(name)
        if told is None or name in (_REWARD, _DONE) or key in _ASKED - needed:
            continue
        feature = _take(key, name, told, codec, needed=key in needed)
        if feature is not None:
            taken.columns[key] = feature
        unit = told.info.get("depth_unit") if isinstance(told.info, dict) else None
        if unit in ("m", "mm"):
            taken.units[name] = str(unit)
    for name in (_REWARD, _SUCCESS, _DONE, "next.terminated", _TRUNCATED):
        if name in info.features:
            taken.outcomes[name] = Feature(name, name, torch.float64, (1,))
    taken.columns.pop("terminated", None)
    check_sizes(taken.features, "meta/info.json", "mend the dataset")
    return taken


def _take(
    key: NestedKey, name: str, told: FeatureInfo, codec: CompactTransitions, *, needed: bool
) -> Feature | None:
    """The feature as a column; None where it is not needed and something else by a name of ours."""
    shape = tuple(told.shape)
    if key in _PICTURES and told.dtype in ("image", "video"):
        if told.dtype == "video" or len(shape) != 3:
            if not needed:
                return None
            raise ConfigError(
                f"{name!r} is told as {told.dtype} of shape {shape}: give a picture a frame, dtype image of "
                "shape (H, W, C), which loses nothing."
            )
        axes = told.names if isinstance(told.names, list) and told.names else [""]
        size = shape[1:] if str(axes[0]).startswith("channel") else shape[:2]
        kind = _PICTURES[key]
        return Feature(name, key, _PICTURE_TYPES[kind], (*size, 3) if kind == "rgb" else size, kind)
    labels = default_labels()
    expected = tuple(labels[key].shape) if key in labels else _SHAPES.get(key, shape)
    numbers = told.dtype in ("bool", "float16", "float32", "float64") or "int" in told.dtype
    if not numbers or shape != expected:
        if key == keys.JOINTS and not needed:  # LeRobot's name for any robot's state
            return None
        raise ConfigError(
            f"{name!r} is told as {told.dtype} of shape {shape}, expected numbers of shape {expected}: mend "
            "the dataset, or give the feature another name."
        )
    return Feature(name, key, _find_type(key, labels, codec), shape)


def _find_type(key: NestedKey, labels: Mapping[NestedKey, Tensor], codec: CompactTransitions) -> torch.dtype:
    if key in labels:
        return labels[key].dtype
    if key == codec.points_key:
        return torch.float16
    if key in _PICTURES:
        return _PICTURE_TYPES[_PICTURES[key]]
    return torch.int64 if key == keys.NUM_POINTS else torch.float32


def others_to_rows(frames: Frames, taken: Taken, codec: CompactTransitions) -> TensorDict:
    """One episode's frames (T) to rows (T); labels that it lacks are stored as absent.

    ConfigError names the episode and the feature that holds no finite numbers or ends too early.
    """
    length = len(frames)
    rows = TensorDict({}, [length])
    for key, feature in taken.columns.items():
        rows[key] = _read(frames, feature, unit=taken.units.get(feature.name))
    for key, default in default_labels().items():
        if key not in taken.columns:
            rows[key] = default.expand(length, *default.shape).clone()
    if keys.TIME_LEFT in codec.observation_keys:
        rows[keys.TIME_LEFT] = _read_time(frames, rows)
    _check_points(rows, frames, codec)
    return _set_outcomes(rows, frames, taken).set(STUB, torch.zeros(length, 1, dtype=torch.bool))


def _read(frames: Frames, feature: Feature, *, unit: str | None = None) -> Tensor:
    if feature.picture is not None:
        return frames.tensor(feature, unit)
    return read_column(
        frames.numbers(feature),
        f"Episode {frames.number}: {feature.name!r}",
        lengths=[len(frames)],
        shape=feature.shape,
        dtype=feature.dtype,
    )


def _read_time(frames: Frames, rows: TensorDict) -> Tensor:
    """The share of the episode's steps that is left; counted where it is not told."""
    length = len(frames)
    left = rows.get(keys.TIME_LEFT, None)
    if left is None:
        return ((length - torch.arange(length)) / length)[:, None]
    if not bool(((left >= 0) & (left <= 1)).all()):
        raise ConfigError(
            f"Episode {frames.number}: {NAMES[keys.TIME_LEFT]!r} is out of range: give the share of the "
            "steps that is left, in [0, 1]."
        )
    return left


def _check_points(rows: TensorDict, frames: Frames, codec: CompactTransitions) -> None:
    points = None if codec.points_key is None else rows[codec.points_key]
    if points is not None and (points.ndim != 3 or (codec.gripper_points and points.shape[-1] != 3)):
        raise ConfigError(
            f"Episode {frames.number}: {codec.points_key!r} of shape {tuple(points.shape)}: expected clouds "
            "(T, N, 3) without the gripper's points, or CompactTransitions(gripper_points=False) for others."
        )


def _set_outcomes(rows: TensorDict, frames: Frames, taken: Taken) -> TensorDict:
    """Reward, ends and success; nothing tells what follows the last frame, so that all are terminated."""
    found = {name: _read(frames, feature) for name, feature in taken.outcomes.items()}
    end = (torch.arange(len(frames)) == len(frames) - 1)[:, None]
    for name in (_DONE, "next.terminated", _TRUNCATED):
        if name in found:
            check_end(found[name] != 0, f"Episode {frames.number}: {name!r}")
    reward = found[_REWARD] if _REWARD in found else (found[_SUCCESS] != 0)
    success = found[_SUCCESS] if _SUCCESS in found else found[_REWARD] > 0.5
    rows["reward"], rows["done"], rows["terminated"] = reward.float(), end, end.clone()
    solved = bool((success[-1:] != 0).any())
    return rows.set(keys.EPISODE_SUCCESS, torch.full((len(frames), 1), solved))
