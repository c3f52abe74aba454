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
        points = gripper_control_points()
        self._marked = torch.cat((points, torch.ones_like(points[:, :1])), dim=-1)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        points = next_tensordict.get(keys.POINTS)
        num_points = points.shape[-2]
        cloud = points.new_zeros(*points.shape[:-2], num_points + len(self._marked), 4)
        cloud[..., :num_points, :3] = points
        cloud[..., num_points:, :] = self._marked.to(points)
        next_tensordict.set(keys.POINTS, cloud)
        return next_tensordict

    def _out_shapes(self, observation_spec: Composite) -> dict:
        num_points = observation_spec[keys.POINTS].shape[-2]
        return {keys.POINTS: ((num_points + len(self._marked), 4), torch.float32)}
