"""AppendGripperPoints: the hand itself as six marked points of the cloud."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.geometry import gripper_control_points
from torchgrasp.transforms.base import PointTransform


class AppendGripperPoints(PointTransform):
    """POINTS (*, N, 3) to (*, N + 6, 4): a flag channel, and X_g of Eq. (2) with flag 1 at the end.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> AppendGripperPoints()(TensorDict({"points": torch.rand(5, 10, 3)}, [5]))["points"][0, :, 3].sum()
        tensor(6.)
    """

    def __init__(self) -> None:
        super().__init__(in_keys=[keys.POINTS], out_keys=[keys.POINTS])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        points = next_tensordict.get(keys.POINTS)
        gripper = gripper_control_points(dtype=points.dtype, device=points.device)
        gripper = gripper.expand(*points.shape[:-2], *gripper.shape)
        cloud = torch.cat((points, gripper), dim=-2)
        flag = torch.zeros_like(cloud[..., :1])
        flag[..., -gripper.shape[-2] :, :] = 1.0
        next_tensordict.set(keys.POINTS, torch.cat((cloud, flag), dim=-1))
        return next_tensordict

    def _out_shapes(self, observation_spec: Composite) -> dict:
        num_points = observation_spec[keys.POINTS].shape[-2]
        return {keys.POINTS: ((num_points + len(gripper_control_points()), 4), torch.float32)}
