"""WristAngle: how far the hand can still turn about its own axis."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.transforms.base import PointTransform

_WRIST = 6  # the last of the arm's seven joints


class WristAngle(PointTransform):
    """Writes WRIST_ANGLE (*, 1): the angle of the arm's last joint, radians in -2.9 to 2.9.

    That joint turns the hand about its z, and stops 166 degrees to either side. A grasp and its half turn
    look the same in the hand's frame; which of them the wrist reaches, this number tells. Networks read it by
    `state_inputs`. The paper's policies see the object alone.

    Example:
        >>> from tensordict import TensorDict
        >>> WristAngle()(TensorDict({"joints": torch.arange(9.0)[None]}, [1]))["wrist_angle"]
        tensor([[6.]])
    """

    def __init__(self) -> None:
        super().__init__(in_keys=[keys.JOINTS], out_keys=[keys.WRIST_ANGLE])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        joints = next_tensordict.get(keys.JOINTS)
        return next_tensordict.set(keys.WRIST_ANGLE, joints[..., _WRIST : _WRIST + 1].to(torch.float32))

    def _out_shapes(self, observation_spec: Composite) -> dict:
        return {keys.WRIST_ANGLE: ((1,), torch.float32)}
