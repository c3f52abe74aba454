"""DepthToPoints: the target's pixels to points in the hand frame."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.errors import check_range
from torchgrasp.geometry import invert_pose, transform_points
from torchgrasp.transforms.base import PointTransform, flat_batch, pad_clouds


class DepthToPoints(PointTransform):
    """Back-projects the target's pixels: DEPTH, MASK to POINTS (*, H W, 3) and NUM_POINTS (*, 1).

    The points X_t are in metres in the hand frame at t, through T_BASE_EE and T_BASE_CAMERA; the first
    NUM_POINTS rows hold points, the others zeros.

    Args:
        fov: the camera's vertical field of view, radians.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> td = TensorDict({"camera": {"depth": torch.ones(8, 8), "mask": torch.eye(8).bool()},
        ...                  "T_base_ee": torch.eye(4), "T_base_camera": torch.eye(4)})
        >>> DepthToPoints()(td)["num_points"].item()
        8
    """

    def __init__(self, *, fov: float = math.pi / 2) -> None:
        check_range("transforms.points.fov", fov, 0.0, math.pi * 0.95, open_low=True)
        super().__init__(
            in_keys=[keys.DEPTH, keys.MASK, keys.T_BASE_EE, keys.T_BASE_CAMERA],
            out_keys=[keys.POINTS, keys.NUM_POINTS],
        )
        self.fov = fov
        self._rays: Tensor | None = None
        self._rays_of: tuple[int, int, torch.device] | None = None

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        depth, mask, T_base_ee, T_base_camera = (
            flat_batch(next_tensordict.get(key), next_tensordict) for key in self.in_keys
        )
        height, width = depth.shape[-2:]
        rays = self._pixel_rays(height, width, depth.device)
        seen = (mask & (depth > 0)).reshape(len(depth), -1)
        depth = depth.reshape(len(depth), -1)
        T_ee_camera = invert_pose(T_base_ee) @ T_base_camera
        clouds = []
        for row, pixels in enumerate(seen):
            index = pixels.nonzero()[:, 0]
            clouds.append(transform_points(T_ee_camera[row], rays[index] * depth[row, index, None]))
        points, counts = pad_clouds(clouds, height * width)
        batch = next_tensordict.batch_size
        next_tensordict.set(keys.POINTS, points.reshape(*batch, -1, 3))
        next_tensordict.set(keys.NUM_POINTS, counts.reshape(*batch, 1).to(points.device))
        return next_tensordict

    def _pixel_rays(self, height: int, width: int, device: torch.device) -> Tensor:
        """(H W, 3) directions through the pixels' centres, camera frame (OpenCV), z = 1."""
        if self._rays is None or self._rays_of != (height, width, device):
            focal = height / 2 / math.tan(self.fov / 2)
            v = (torch.arange(height, device=device) + 0.5 - height / 2) / focal
            u = (torch.arange(width, device=device) + 0.5 - width / 2) / focal
            v, u = torch.meshgrid(v, u, indexing="ij")
            self._rays_of = (height, width, device)
            self._rays = torch.stack((u, v, torch.ones_like(u)), dim=-1).reshape(-1, 3)
        return self._rays

    def _out_shapes(self, observation_spec: Composite) -> dict:
        height, width = observation_spec[keys.DEPTH].shape[-2:]
        return {keys.POINTS: ((height * width, 3), torch.float32), keys.NUM_POINTS: ((1,), torch.int64)}
