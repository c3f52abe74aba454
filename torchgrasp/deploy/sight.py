"""What an arm's camera tells in one step: pictures or clouds, checked, in the units of the policy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from torchgrasp.deploy.arguments import read_array
from torchgrasp.errors import ConfigError
from torchgrasp.intrinsics import CameraIntrinsics

Frame = Literal["ee", "camera", "base"]
FRAMES = ("ee", "camera", "base")
# Metres: where a sensor tells nothing, something may stand right before it. Nothing is looked through there.
_UNKNOWN = 1e-3
_FARTHEST = 3.0  # metres: no arm reaches a target that is farther from its hand


@dataclass(frozen=True)
class Sight:
    """One look at the target.

    Attributes:
        depth: (H, W) float32 metres, or None for a cloud.
        mask: (H, W) bool, the target's pixels that have a depth.
        points: (n, 3) float32 metres, in the frame that the caller named, or None for a picture.
        problem: why it cannot be used; None where it can.
    """

    depth: np.ndarray | None = None
    mask: np.ndarray | None = None
    points: np.ndarray | None = None
    problem: str | None = None

    @property
    def shows_target(self) -> bool:
        """Whether a point of the target is seen."""
        seen = self.mask if self.points is None else self.points
        return seen is not None and bool(seen.any() if seen is self.mask else len(seen))


def choose_thin(intrinsics: CameraIntrinsics, training: CameraIntrinsics) -> int:
    """Every so many rows and columns are kept, of pixels at least twice as fine as those of training."""
    return max(1, int(float(intrinsics.focal.min()) / (2 * float(training.focal.min()))))


def read_picture(
    depth: Any, mask: Any, intrinsics: CameraIntrinsics, *, thin: int, holes_are_empty: bool
) -> Sight:
    """A picture as the policy's transforms take it.

    Args:
        depth: (H, W) metres as floats, or millimetres as 16-bit whole numbers; 0, NaN, infinity and what is
            nearer than `intrinsics.near` are holes.
        mask: (H, W), not zero at the target's pixels. One beyond `intrinsics.far` is not seen.
        intrinsics: of the camera.
        thin: every so many rows and columns are kept.
        holes_are_empty: whether nothing stands within range where there is a hole.

    Raises:
        ConfigError: where `depth` or `mask` is no picture at all.
    """
    depth, mask = _read_depth(depth), _read_mask(mask)
    size = (intrinsics.height, intrinsics.width)
    for name, picture in (("depth", depth), ("mask", mask)):
        if picture.shape != size:
            told = f"{picture.shape[1]} x {picture.shape[0]}"
            return Sight(problem=f"{name} of {told} pixels, where intrinsics say {size[1]} x {size[0]}")
    depth, mask = depth[::thin, ::thin], mask[::thin, ::thin]
    depth = depth * np.float32(1e-3) if depth.dtype.kind in "iu" else depth.astype(np.float32)
    with np.errstate(invalid="ignore"):  # NaN is in no range
        there = np.isfinite(depth) & (depth > 0) & (depth >= intrinsics.near)
        within = there & (depth <= intrinsics.far)
    if not there.any():
        return Sight(problem="depth has no return at any pixel")
    if mask.any() and not (mask & there).any():
        return Sight(problem="depth has no return at the target's pixels")
    if mask.any() and not (mask & within).any():
        return Sight(
            problem=f"the target's pixels lie beyond far={intrinsics.far} m (depth as floats is in metres)"
        )
    depth = np.where(there, depth, np.float32(0.0 if holes_are_empty else _UNKNOWN))
    return Sight(depth=depth, mask=mask & within)


def read_cloud(points: Any) -> Sight:
    """A cloud (n, 3), metres; rows with NaN are left out.

    Raises:
        ConfigError: where it is none.
    """
    points = read_array("points", points)
    if points.size == 0 and points.ndim < 3:
        return Sight(points=np.zeros((0, 3), dtype=np.float32))
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise ConfigError(f"points of shape {points.shape} and type {points.dtype}: give (n, 3) metres.")
    points = points.astype(np.float32)
    there = np.isfinite(points).all(axis=1)
    if not there.any():
        return Sight(problem="points are all NaN or infinite")
    return Sight(points=points[there])


def into_hand(sight: Sight, T_base_ee: np.ndarray, T_base_camera: np.ndarray | None, frame: Frame) -> Sight:
    """A cloud of `frame` in the hand's frame, (4, 4) poses given; no target where it is out of reach.

    Raises:
        ConfigError: where nothing tells how the frame lies.
    """
    if frame == "camera" and T_base_camera is None:
        raise ConfigError(
            "frame='camera', and nothing tells where the camera is: give T_ee_camera or T_base_camera to "
            "GraspAgent, or T_base_camera to each act."
        )
    if sight.points is None or not len(sight.points):
        return sight
    points = sight.points
    if frame != "ee":
        T_base_points = T_base_camera if frame == "camera" else np.eye(4)
        T_ee_points = np.linalg.solve(T_base_ee, cast(np.ndarray, T_base_points))
        points = (points @ T_ee_points[:3, :3].T + T_ee_points[:3, 3]).astype(np.float32)
    near = np.linalg.norm(points, axis=1) < _FARTHEST
    if not near.any():
        return Sight(problem=f"no point lies within {_FARTHEST} m of the hand (points are in metres)")
    return Sight(points=points[near])


def _read_depth(depth: Any) -> np.ndarray:
    depth = _read_picture("depth", depth, "metres or 16-bit millimetres")
    if depth.dtype.kind in "iub" and depth.dtype.itemsize != 2:
        raise ConfigError(
            f"depth of type {depth.dtype}: give metres as floats, or millimetres as 16-bit whole numbers."
        )
    return depth


def _read_mask(mask: Any) -> np.ndarray:
    """(H, W) bool."""
    mask = _read_picture("mask", mask, "not zero at the target")
    if mask.dtype.kind == "f" and not np.isin(mask, (0.0, 1.0)).all():
        raise ConfigError("mask has values between 0 and 1, or NaN: give bool, as by probability > 0.5.")
    return mask != 0


def _read_picture(name: str, picture: Any, meaning: str) -> np.ndarray:
    picture = read_array(name, picture)
    if picture.ndim != 2 or picture.dtype.kind not in "fiub":
        raise ConfigError(
            f"{name} of shape {picture.shape} and type {picture.dtype}: give (H, W) numbers, {meaning}."
        )
    return picture
