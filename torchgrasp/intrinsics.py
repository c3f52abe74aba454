"""The pinhole camera: which way a pixel looks, and where a point is seen."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchgrasp.errors import ConfigError, check_range, check_whole

_MAX_SIDE = 8192  # pixels: a picture beyond that does not fit in memory, and no sensor makes one


@dataclass(frozen=True)
class CameraIntrinsics:
    """A pinhole camera in OpenCV axes (z forward, x right, y down), simulated or real.

    By default its pixels are square and it looks at the middle of its picture. A calibrated camera has focal
    lengths and a centre of its own, as OpenCV's calibration, ROS's `camera_info` and the makers' tools tell
    them: the centre of the first pixel is at (0, 0).

    Attributes:
        width, height: pixels.
        fov: vertical field of view, radians; not looked at where `fx` is given.
        near, far: depths along z in metres between which something is seen.
        fx, fy: focal lengths in pixels; `fy` is `fx` if None.
        cx, cy: pixels at which the optical axis meets the picture; its middle if None.

    Example:
        >>> CameraIntrinsics(848, 480, fx=610.0, cx=421.3, cy=243.9).focal
        array([610., 610.])
    """

    width: int = 112
    height: int = 112
    fov: float = np.pi / 2
    near: float = 0.035
    far: float = 2.0
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None

    def __post_init__(self) -> None:
        check_whole("width", self.width, 1, _MAX_SIDE)
        check_whole("height", self.height, 1, _MAX_SIDE)
        check_range("fov", self.fov, 0.0, np.pi * 0.95, open_low=True)
        check_range("near", self.near, 0.0, np.inf)
        check_range("far", self.far, self.near, np.inf, open_low=True)
        for name, focal in (("fx", self.fx), ("fy", self.fy)):
            if focal is not None:
                check_range(name, focal, 0.0, np.inf, open_low=True)
        if self.fy is not None and self.fx is None:
            raise ConfigError("fy is given without fx: give both, or fx alone for square pixels.")
        for name, centre, size in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if centre is not None:
                check_range(name, centre, -0.5, size - 0.5)

    @classmethod
    def from_matrix(cls, matrix: Any, *, width: int, height: int, **others: Any) -> CameraIntrinsics:
        """The camera of a (3, 3) matrix K, or its nine numbers in rows, and of its picture's size.

        That is how calibration tools and ROS's `camera_info` tell it. The picture must be rectified: no lens
        distorts it.

        Example:
            >>> k = [[610, 0, 421], [0, 612, 244], [0, 0, 1]]
            >>> CameraIntrinsics.from_matrix(k, width=848, height=480).fy
            612.0
        """
        k = np.asarray(matrix, dtype=np.float64)
        k = k.reshape(3, 3) if k.shape == (9,) else k
        if k.shape != (3, 3) or k[0, 1] or not np.array_equal(k[[1, 2, 2, 2], [0, 0, 1, 2]], (0, 0, 0, 1)):
            raise ConfigError(
                f"matrix of shape {k.shape} is no camera matrix: give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."
            )
        (fx, _, cx), (_, fy, cy) = k[:2].tolist()
        return cls(width, height, fx=fx, fy=fy, cx=cx, cy=cy, **others)

    @functools.cached_property
    def size(self) -> np.ndarray:
        """(2,) width and height, pixels."""
        return np.array((self.width, self.height))

    @functools.cached_property
    def focal(self) -> np.ndarray:
        """(2,) focal lengths along x and y, pixels."""
        if self.fx is None:
            return np.full(2, self.height / 2 / np.tan(self.fov / 2))
        return np.array((self.fx, self.fx if self.fy is None else self.fy))

    @functools.cached_property
    def centre(self) -> np.ndarray:
        """(2,) where the optical axis meets the picture, pixels from its left and upper edge."""
        given = zip((self.cx, self.cy), self.size / 2, strict=True)
        return np.array([middle if axis is None else axis + 0.5 for axis, middle in given])

    @functools.cached_property
    def rays(self) -> np.ndarray:
        """(height * width, 3) float32 directions through the pixels' centres, camera frame, z = 1."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        u = (np.arange(self.width) + 0.5 - cx) / fx
        v = (np.arange(self.height) + 0.5 - cy) / fy
        grid = np.stack(np.meshgrid(u, v), axis=-1)
        return (
            np.concatenate((grid, np.ones((*grid.shape[:2], 1))), axis=-1).reshape(-1, 3).astype(np.float32)
        )

    def thin_out(self, step: int) -> CameraIntrinsics:
        """The camera of a picture of which every `step`-th row and column is kept, from the first on.

        Example:
            >>> CameraIntrinsics(848, 480, fx=600.0).thin_out(4).focal
            array([150., 150.])
        """
        check_whole("step", step, 1, min(self.width, self.height))
        fx, fy = (self.focal / step).tolist()
        cx, cy = ((self.centre - 0.5) / step).tolist()
        size = {"width": -(-self.width // step), "height": -(-self.height // step)}
        return replace(self, **size, fx=fx, fy=fy, cx=cx, cy=cy)
