"""What an arm's camera tells in one step: pictures or clouds, checked, in the units of the policy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from torchgrasp.errors import ConfigError
from torchgrasp.intrinsics import CameraIntrinsics

Frame = Literal["ee", "camera", "base"]
FRAMES = ("ee", "camera", "base")
# Metres: where a sensor tells nothing, something may stand right before it. Nothing is looked through there.
_UNKNOWN = 1e-3


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


def read_picture(
    depth: Any, mask: Any, intrinsics: CameraIntrinsics, *, thin: int, holes_are_empty: bool
) -> Sight:
    """A picture as the policy's transforms take it.

    Args:
        depth: (H, W) metres as floats, or millimetres as 16-bit whole numbers; 0, NaN and infinity are holes.
        mask: (H, W), not zero at the target's pixels.
        intrinsics: of the camera.
        thin: every so many rows and columns are kept.
        holes_are_empty: whether nothing stands within range where there is a hole.

    Raises:
        ConfigError: where `depth` or `mask` is no picture at all.
    """
    depth, mask = _as_picture("depth", depth), _as_picture("mask", mask)
    size = (intrinsics.height, intrinsics.width)
    for name, picture in (("depth", depth), ("mask", mask)):
        if picture.shape != size:
            told = f"{picture.shape[1]} x {picture.shape[0]}"
            return Sight(problem=f"{name} of {told} pixels, where intrinsics say {size[1]} x {size[0]}")
    depth, mask = depth[::thin, ::thin], mask[::thin, ::thin] != 0
    if depth.dtype.kind in "iu":
        depth = depth * np.float32(1e-3)
    depth = depth.astype(np.float32)
    there = np.isfinite(depth) & (depth > 0)
    if not there.any():
        return Sight(problem="depth has no return at any pixel")
    if mask.any() and not (mask & there).any():
        return Sight(problem="depth has no return at the target's pixels")
    depth = np.where(there, depth, np.float32(0.0 if holes_are_empty else _UNKNOWN))
    return Sight(depth=depth, mask=mask & there)


def read_cloud(points: Any) -> Sight:
    """A cloud (n, 3), metres; rows with NaN are left out.

    Raises:
        ConfigError: where it is none.
    """
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise ConfigError(f"points of shape {points.shape} and type {points.dtype}: give (n, 3) metres.")
    points = points.astype(np.float32)
    there = np.isfinite(points).all(axis=1)
    if len(points) and not there.any():
        return Sight(problem="points are all NaN")
    return Sight(points=points[there])


def _as_picture(name: str, picture: Any) -> np.ndarray:
    picture = np.asarray(picture)
    if picture.ndim != 2 or picture.dtype.kind not in "fiub":
        raise ConfigError(
            f"{name} of shape {picture.shape} and type {picture.dtype}: give (H, W) numbers, "
            + ("metres or 16-bit millimetres." if name == "depth" else "not zero at the target.")
        )
    if name == "depth" and picture.dtype.kind in "iub" and picture.dtype.itemsize != 2:
        raise ConfigError(
            f"depth of type {picture.dtype}: give metres as floats, or millimetres as 16-bit whole numbers."
        )
    return picture
