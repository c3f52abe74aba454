"""DepthToPoints: the target's pixels to points in the hand frame."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.transforms.base import (
    CameraName,
    PointTransform,
    camera_keys,
    check_lens,
    choose_intrinsics,
    pad_clouds,
    read_rows,
    write_clouds,
)


class DepthToPoints(PointTransform):
    """Back-projects the target's pixels: DEPTH, MASK to POINTS (*, H W, 3) and NUM_POINTS (*, 1).

    The points X_t are in metres in the hand frame at t, through T_BASE_EE and T_BASE_CAMERA; the first
    NUM_POINTS rows hold points, the others zeros.

    Args:
        fov: the camera's vertical field of view, radians; 90 degrees by default.
        intrinsics: of the camera instead, where its pictures have a size, focal lengths and a centre of
            their own.
        camera: whose picture: the wrist's, or the static one's with its pose T_BASE_OVERHEAD.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> td = TensorDict({"camera": {"depth": torch.ones(8, 8), "mask": torch.eye(8).bool()},
        ...                  "T_base_ee": torch.eye(4), "T_base_camera": torch.eye(4)})
        >>> DepthToPoints()(td)["num_points"].item()
        8
    """

    def __init__(
        self,
        *,
        fov: float | None = None,
        intrinsics: CameraIntrinsics | None = None,
        camera: CameraName = "wrist",
    ) -> None:
        check_lens(intrinsics, fov)
        source = camera_keys(camera)
        super().__init__(
            in_keys=[source.depth, source.mask, keys.T_BASE_EE, source.pose],
            out_keys=[keys.POINTS, keys.NUM_POINTS],
        )
        self.fov, self.intrinsics = fov, intrinsics

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        depth, mask, T_base_ee, T_base_camera = read_rows(next_tensordict, *self.in_keys)
        height, width = depth.shape[-2:]
        rays = choose_intrinsics(self.intrinsics, self.fov, height, width).rays
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

    def _out_shapes(self, observation_spec: Composite) -> dict:
        height, width = observation_spec[self.in_keys[0]].shape[-2:]
        return {keys.POINTS: ((height * width, 3), torch.float32), keys.NUM_POINTS: ((1,), torch.int64)}
