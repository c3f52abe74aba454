"""TablePlane: where the table lies, as the robot knows it from its own joints."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.transforms.base import PointTransform


class TablePlane(PointTransform):
    """Writes TABLE_PLANE (*, 4): the table's upward unit normal in the ee frame, then the hand's height.

    A point p of the ee frame lies ``plane[:3] @ p + plane[3]`` metres above the table. Nothing is
    measured: the table top is z = 0 of the base frame, and forward kinematics (T_BASE_EE) tell the rest, on
    a real robot as well. Networks read it by `table_input`. The paper's policies see the object alone.

    Args:
        height: of the table top above the origin of the base frame, metres.

    Example:
        >>> from tensordict import TensorDict
        >>> hand = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))  # looks down, 30 cm above the table
        >>> hand[2, 3] = 0.3
        >>> TablePlane()(TensorDict({"T_base_ee": hand}))["table_plane"]
        tensor([ 0.0000,  0.0000, -1.0000,  0.3000])
    """

    def __init__(self, height: float = 0.0) -> None:
        super().__init__(in_keys=[keys.T_BASE_EE], out_keys=[keys.TABLE_PLANE])
        self._height = float(height)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        up = next_tensordict.get(keys.T_BASE_EE)[..., 2, :].clone()
        up[..., 3] -= self._height
        return next_tensordict.set(keys.TABLE_PLANE, up)

    def _out_shapes(self, observation_spec: Composite) -> dict:
        return {keys.TABLE_PLANE: ((4,), torch.float32)}
