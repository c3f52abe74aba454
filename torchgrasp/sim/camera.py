"""What a camera is: intrinsics, a mount, and pictures as a function of a world's state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchgrasp.errors import ConfigError
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.objects.model import GraspObject

# Released code: the camera sits at (0.036, 0, 0.036) of the hand and looks along the hand's z.
# OpenCV axes: x right = hand y, y down = hand -x, z forward = hand z.
T_EE_CAMERA = np.array(
    [[0.0, -1.0, 0.0, 0.036], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.036], [0.0, 0.0, 0.0, 1.0]]
)


@dataclass(frozen=True)
class View:
    """The state of one world as far as a camera sees it.

    Attributes:
        target: the object whose pixels the mask marks.
        T_base_object: (4, 4) its pose.
        joints: (9,) arm angles (rad) and finger positions (m).
        T_base_ee: (4, 4) hand pose, which follows from the joints.
        appearance: seed of the episode's textures and light; cameras without colour ignore it.
    """

    target: GraspObject
    T_base_object: np.ndarray
    joints: np.ndarray
    T_base_ee: np.ndarray
    appearance: int = 0


def look_at(
    position: Sequence[float], target: Sequence[float], *, up: Sequence[float] = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """(4, 4) pose of a camera at `position` whose optical axis passes through `target`.

    Args:
        position: (3,) metres, base frame.
        target: (3,) metres, base frame.
        up: (3,) direction that shows upwards in the picture.

    Example:
        >>> look_at((0.0, 0.0, 1.0), (1.0, 0.0, 1.0)).round(6)[:3, 2].tolist()
        [1.0, 0.0, 0.0]
    """
    place = np.asarray(position, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - place
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    if not np.linalg.norm(right) > 1e-9 * max(1.0, float(np.linalg.norm(forward))):
        raise ConfigError(
            f"A camera at {place.tolist()} that looks at {list(target)} with {list(up)} upwards has no "
            "direction: move one of the points, or give another `up`."
        )
    frame = np.eye(4)
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    frame[:3, :3] = np.stack((right, np.cross(forward, right), forward), axis=-1)
    frame[:3, 3] = place
    return frame


@dataclass(frozen=True)
class LookAt:
    """`look_at` as a part that a configuration can name: an array (4, 4) wherever one is taken.

    Attributes:
        position: (3,) metres, base frame.
        target: (3,) metres, base frame.
        up: (3,) direction that shows upwards in the picture.

    Example:
        >>> np.asarray(LookAt((1.4, 0.0, 0.9), (0.5, 0.0, 0.0)))[:3, 3].tolist()
        [1.4, 0.0, 0.9]
    """

    position: Sequence[float]
    target: Sequence[float]
    up: Sequence[float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        look_at(self.position, self.target, up=self.up)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return look_at(self.position, self.target, up=self.up).astype(dtype or np.float64)


class Camera(ABC):
    """A camera on the wrist or, with `T_base_camera`, one that stands still.

    Pictures depend on the view alone, never on what was seen before: a camera is shared by worlds and
    may be built anew in every process.

    Args:
        intrinsics: picture size, field of view and range.
        T_ee_camera: (4, 4) pose of the camera in the hand frame.
        T_base_camera: (4, 4) pose of a static camera in the base frame, which takes the place of the
            former.
    """

    #: Pictures that `observe` gives: "depth" and "mask", and "rgb" from cameras that render.
    channels: tuple[str, ...] = ("depth", "mask")

    def __init__(
        self,
        intrinsics: CameraIntrinsics | None = None,
        *,
        T_ee_camera: np.ndarray = T_EE_CAMERA,
        T_base_camera: np.ndarray | None = None,
    ) -> None:
        self.intrinsics = intrinsics or CameraIntrinsics()
        self.T_ee_camera = np.asarray(T_ee_camera, dtype=np.float64)
        self.T_base_camera = None if T_base_camera is None else np.asarray(T_base_camera, dtype=np.float64)

    def pose(self, T_base_ee: np.ndarray) -> np.ndarray:
        """(*, 4, 4) hand poses to the (*, 4, 4) camera poses T_base_camera."""
        if self.T_base_camera is not None:
            return np.broadcast_to(self.T_base_camera, T_base_ee.shape).copy()
        return T_base_ee @ self.T_ee_camera

    @abstractmethod
    def observe(self, view: View) -> dict[str, np.ndarray]:
        """One picture of each channel.

        Returns:
            ``depth``, (H, W) float32 along the camera's z in metres, 0 where nothing is seen; ``mask``,
            (H, W) bool, the target's pixels; ``rgb``, (H, W, 3) uint8, from cameras that render.
        """
