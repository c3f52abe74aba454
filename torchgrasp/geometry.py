"""Rigid poses as (*, 4, 4) tensors, and the gripper's control points.

`T_a_b` takes coordinates in frame b to frame a. Quaternions are roma's xyzw. Euler angles are
intrinsic XYZ: R = Rx(a) Ry(b) Rz(c). Metres and radians throughout.
"""

from __future__ import annotations

import math

import roma
import torch
from torch import Tensor

ACTION_SIZE = 6
# Released code: the largest relative pose of one step, 6 cm and 30 degrees a component.
ACTION_BOUND = (0.06, 0.06, 0.06, math.pi / 6, math.pi / 6, math.pi / 6)
GOAL_SIZE = 7
# What stands for a goal where there is none (has_goal is false): no pose, its quaternion has no length.
NO_GOAL = (0.0,) * GOAL_SIZE

# X_g of Eq. (2): palm twice, finger bases, finger tips, in the ee frame (released code's values).
_CONTROL_POINTS = (
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0),
    (0.0, 0.053, 0.075),
    (0.0, -0.053, 0.075),
    (0.0, 0.053, 0.105),
    (0.0, -0.053, 0.105),
)
_KEPT: dict[tuple[torch.dtype, torch.device], Tensor] = {}


def gripper_control_points(
    *, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> Tensor:
    """X_g of Eq. (2), (6, 3) in metres, ee frame: palm twice, finger bases, finger tips."""
    if torch.device(device).type == "cpu":
        return torch.tensor(_CONTROL_POINTS, dtype=dtype)
    return _kept_points(dtype, torch.device(device)).clone()


def _kept_points(dtype: torch.dtype, device: torch.device) -> Tensor:
    """The control points there: a copy from the host waits for a GPU, and no CUDA graph can hold it."""
    points = _KEPT.get((dtype, device))
    if points is None:
        points = torch.tensor(_CONTROL_POINTS, dtype=dtype, device=device)
        if type(points) is Tensor:  # none that only stands for one while torch traces
            _KEPT[dtype, device] = points
    return points


# What torch.compiler.assume_constant_result does; that would load torch's compiler here.
setattr(_kept_points, "_dynamo_marked_constant", True)  # noqa: B010


def make_pose(rotation: Tensor, translation: Tensor) -> Tensor:
    """(*, 3, 3) rotation and (*, 3) translation in metres to a (*, 4, 4) pose."""
    top = torch.cat((rotation, translation.unsqueeze(-1)), dim=-1)
    bottom = torch.zeros_like(top[..., :1, :])
    bottom[..., 3] = 1.0
    return torch.cat((top, bottom), dim=-2)


def invert_pose(T_a_b: Tensor) -> Tensor:
    """(*, 4, 4) pose T_a_b to T_b_a, exact for rigid poses."""
    rotation = T_a_b[..., :3, :3].transpose(-1, -2)
    return make_pose(rotation, -(rotation @ T_a_b[..., :3, 3:]).squeeze(-1))


def transform_points(T_a_b: Tensor, points: Tensor) -> Tensor:
    """(*, N, 3) points in frame b to frame a; T_a_b is (*, 4, 4), batch dimensions broadcast."""
    return points @ T_a_b[..., :3, :3].transpose(-1, -2) + T_a_b[..., None, :3, 3]


def euler_to_rotation(angles: Tensor) -> Tensor:
    """(*, 3) intrinsic XYZ Euler angles (radians) to (*, 3, 3) rotations."""
    (ca, cb, cc), (sa, sb, sc) = angles.cos().unbind(-1), angles.sin().unbind(-1)
    sa_sb, ca_sb = sa * sb, ca * sb
    rows = (
        *(cb * cc, -cb * sc, sb),
        *(ca * sc + sa_sb * cc, ca * cc - sa_sb * sc, -sa * cb),
        *(sa * sc - ca_sb * cc, sa * cc + ca_sb * sc, ca * cb),
    )
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def action_to_pose(action: Tensor) -> Tensor:
    """(*, 6) action (metres, intrinsic XYZ Euler radians) to the (*, 4, 4) relative pose T_t_t+1."""
    return make_pose(euler_to_rotation(action[..., 3:6]), action[..., :3])


def pose_to_action(pose: Tensor) -> Tensor:
    """(*, 4, 4) relative pose to the (*, 6) action; inverse of action_to_pose for |b| < pi/2."""
    r = pose[..., :3, :3]
    a = torch.atan2(-r[..., 1, 2], r[..., 2, 2])
    b = torch.asin(r[..., 0, 2].clamp(-1.0, 1.0))
    c = torch.atan2(-r[..., 0, 1], r[..., 0, 0])
    return torch.cat((pose[..., :3, 3], torch.stack((a, b, c), dim=-1)), dim=-1)


def quaternion_to_rotation(quaternion: Tensor) -> Tensor:
    """(*, 4) quaternions xyzw of any non-zero length to (*, 3, 3) rotations.

    The length of one shorter than 1e-6 is clamped, so that the gradient stays finite where a network
    starts at zero; there it turns nothing.
    """
    length = torch.linalg.vector_norm(quaternion, dim=-1, keepdim=True).clamp_min(1e-6)
    unit = quaternion / length
    axes = torch.eye(3, dtype=unit.dtype, device=unit.device).expand(*unit.shape[:-1], 3, 3)
    # With q = (v, w), a vector p becomes p + 2 (w (v x p) + v x (v x p)); those of the axes are columns.
    v, w = unit[..., None, :3].expand_as(axes), unit[..., None, 3:]
    normal = torch.linalg.cross(v, axes)
    return (axes + 2.0 * (w * normal + torch.linalg.cross(v, normal))).mT


def goal_to_pose(goal: Tensor) -> Tensor:
    """(*, 7) goal (metres, quaternion xyzw of any non-zero length) to a (*, 4, 4) pose."""
    return make_pose(quaternion_to_rotation(goal[..., 3:7]), goal[..., :3])


def pose_to_goal(pose: Tensor) -> Tensor:
    """(*, 4, 4) pose to the (*, 7) goal: translation, then quaternion xyzw with w >= 0."""
    quaternion = roma.rotmat_to_unitquat(pose[..., :3, :3])
    quaternion = torch.where(quaternion[..., 3:] < 0, -quaternion, quaternion)
    return torch.cat((pose[..., :3, 3], quaternion), dim=-1)


def look_along(direction: Tensor, roll: Tensor) -> Tensor:
    """(*, 3) directions and (*) rolls (rad) to (*, 3, 3) rotations whose z axis is that direction.

    At roll 0 the x axis lies as near to the base's z axis as it can.
    """
    z = torch.nn.functional.normalize(direction, dim=-1)
    up = z.new_tensor((0.0, 0.0, 1.0)).expand_as(z)
    side = z.new_tensor((1.0, 0.0, 0.0)).expand_as(z)
    up = torch.where((z[..., 2:].abs() > math.cos(1e-3)), side, up)
    y = torch.nn.functional.normalize(torch.linalg.cross(z, up), dim=-1)
    x = torch.linalg.cross(y, z)
    frame = torch.stack((x, y, z), dim=-1)
    c, s, zero, one = roll.cos(), roll.sin(), torch.zeros_like(roll), torch.ones_like(roll)
    spin = torch.stack((c, -s, zero, s, c, zero, zero, zero, one), dim=-1)
    return frame @ spin.reshape(*roll.shape, 3, 3)
