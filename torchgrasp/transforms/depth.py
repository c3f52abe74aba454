"""DepthToPoints: the target's pixels to points in the hand frame."""

from __future__ import annotations

import math

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.errors import check_range
from torchgrasp.transforms.base import (
    CameraName,
    PointTransform,
    camera_keys,
    pad_clouds,
    read_rows,
    write_clouds,
)


class DepthToPoints(PointTransform):
    """Back-projects the target's pixels: DEPTH, MASK to POINTS (*, H W, 3) and NUM_POINTS (*, 1).

    The points X_t are in metres in the hand frame at t, through T_BASE_EE and T_BASE_CAMERA; the first
    NUM_POINTS rows hold points, the others zeros.

    Args:
        fov: the camera's vertical field of view, radians.
        camera: whose picture: the wrist's, or the static one's with its pose T_BASE_OVERHEAD.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> td = TensorDict({"camera": {"depth": torch.ones(8, 8), "mask": torch.eye(8).bool()},
        ...                  "T_base_ee": torch.eye(4), "T_base_camera": torch.eye(4)})
        >>> DepthToPoints()(td)["num_points"].item()
        8
    """

    def __init__(self, *, fov: float = math.pi / 2, camera: CameraName = "wrist") -> None:
        check_range("fov", fov, 0.0, math.pi * 0.95, open_low=True)
        source = camera_keys(camera)
        super().__init__(
            in_keys=[source.depth, source.mask, keys.T_BASE_EE, source.pose],
            out_keys=[keys.POINTS, keys.NUM_POINTS],
        )
        self.fov = fov
        self._rays = np.empty((0, 3), dtype=np.float32)
        self._rays_of = (0, 0)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        depth, mask, T_base_ee, T_base_camera = read_rows(next_tensordict, *self.in_keys)
        height, width = depth.shape[-2:]
        rays = self._pixel_rays(height, width)
        clouds = []
        for row in range(len(depth)):
            index = np.flatnonzero(mask[row])
            z = depth[row].reshape(-1).take(index)
            if (z <= 0).any():
                index, z = index[z > 0], z[z > 0]
            # T_ee_camera = T_base_ee^-1 T_base_camera, of rigid poses.
            to_ee = T_base_ee[row, :3, :3].T @ T_base_camera[row, :3]
            to_ee[:, 3] -= T_base_ee[row, :3, :3].T @ T_base_ee[row, :3, 3]
            clouds.append((rays.take(index, axis=0) * z[:, None]) @ to_ee[:, :3].T + to_ee[:, 3])
        points = pad_clouds(clouds, height * width)
        write_clouds(next_tensordict, points, [len(cloud) for cloud in clouds])
        return next_tensordict

    def _pixel_rays(self, height: int, width: int) -> np.ndarray:
        """(H W, 3) directions through the pixels' centres, camera frame (OpenCV), z = 1."""
        if self._rays_of != (height, width):
            focal = height / 2 / math.tan(self.fov / 2)
            v = (np.arange(height, dtype=np.float32) + 0.5 - height / 2) / focal
            u = (np.arange(width, dtype=np.float32) + 0.5 - width / 2) / focal
            u, v = np.meshgrid(u, v)
            self._rays = np.stack((u, v, np.ones_like(u)), axis=-1).reshape(-1, 3)
            self._rays_of = (height, width)
        return self._rays

    def _out_shapes(self, observation_spec: Composite) -> dict:
        height, width = observation_spec[self.in_keys[0]].shape[-2:]
        return {keys.POINTS: ((height * width, 3), torch.float32), keys.NUM_POINTS: ((1,), torch.int64)}
