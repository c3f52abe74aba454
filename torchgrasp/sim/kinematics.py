"""Kinematics of the Franka Emika Panda's arm, batched in numpy.

One row at a time inside numpy's loops, so that a result never depends on how many rows are computed
beside it. Poses are those of the hand link (frame `ee`) in the robot base.
"""

from __future__ import annotations

import functools

import frankik
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Origin of each joint in its parent link and the roll that follows (franka_ros, metres and radians).
JOINT_ORIGINS = (
    ((0.0, 0.0, 0.333), 0.0),
    ((0.0, 0.0, 0.0), -np.pi / 2),
    ((0.0, -0.316, 0.0), np.pi / 2),
    ((0.0825, 0.0, 0.0), np.pi / 2),
    ((-0.0825, 0.384, 0.0), -np.pi / 2),
    ((0.0, 0.0, 0.0), np.pi / 2),
    ((0.088, 0.0, 0.0), np.pi / 2),
)
FLANGE_LENGTH = 0.107
HAND_YAW = -np.pi / 4
JOINT_LOWER = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
JOINT_UPPER = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
JOINT_VELOCITY = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
JOINT_EFFORT = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])
_NEXT, _AFTER = (1, 2, 0), (2, 0, 1)
READY_POSTURE = np.array([0.0, np.pi / 8, 0.0, -5 * np.pi / 8, 0.0, 3 * np.pi / 4, np.pi / 4])


def _rotation_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def joint_frames() -> Array:
    """(7, 4, 4) pose of each joint, at angle 0, in the link before it; joints turn about their z."""
    frames = np.tile(np.eye(4), (7, 1, 1))
    for frame, (xyz, roll) in zip(frames, JOINT_ORIGINS, strict=True):
        frame[:3, :3], frame[:3, 3] = _rotation_x(roll), xyz
    return frames


@functools.cache
def _joint_terms() -> tuple[Array, Array, Array]:
    """(7, 4, 4) each: C, S, K with which joint i's transform is cos(q_i) C_i + sin(q_i) S_i + K_i."""
    cosine, sine, constant = np.zeros((3, 7, 4, 4))
    for i, frame in enumerate(joint_frames()):
        cosine[i, :, :2] = frame[:, :2]
        sine[i, :, 0], sine[i, :, 1] = frame[:, 1], -frame[:, 0]
        constant[i, :, 2:] = frame[:, 2:]
    return cosine, sine, constant


@functools.cache
def hand_in_link7() -> Array:
    """(4, 4) pose of the hand link in link 7: the flange's length, then the hand's yaw."""
    c, s = np.cos(HAND_YAW), np.sin(HAND_YAW)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, FLANGE_LENGTH], [0, 0, 0, 1.0]])


def link_poses(q: Array) -> Array:
    """(N, 7) joint angles to (N, 8, 4, 4) poses of links 1 to 7 and of the hand, in the base."""
    q = np.asarray(q, dtype=np.float64)[..., None, None]
    cosine, sine, constant = _joint_terms()
    local = np.cos(q) * cosine + np.sin(q) * sine + constant
    poses = np.empty((len(q), 8, 4, 4))
    poses[:, 0] = local[:, 0]
    for i in range(1, 7):
        np.matmul(poses[:, i - 1], local[:, i], out=poses[:, i])
    np.matmul(poses[:, 6], hand_in_link7(), out=poses[:, 7])
    return poses


def forward_kinematics(q: Array) -> Array:
    """(N, 7) joint angles to the (N, 4, 4) hand poses T_base_ee.

    Example:
        >>> (forward_kinematics(READY_POSTURE[None])[0, :3, 3].round(6) + 0.0).tolist()
        [0.615013, 0.0, 0.273182]
    """
    return link_poses(q)[:, 7]


def jacobian(poses: Array) -> Array:
    """(N, 8, 4, 4) link poses to the (N, 6, 7) geometric Jacobian of the hand, base frame."""
    axes = poses[:, :7, :3, 2]
    arms = poses[:, 7:, :3, 3] - poses[:, :7, :3, 3]
    out = np.empty((len(poses), 6, 7))
    turned = out[:, :3].transpose(0, 2, 1)  # axes x arms; np.cross takes long over its arguments
    np.multiply(axes[..., _NEXT], arms[..., _AFTER], out=turned)
    turned -= axes[..., _AFTER] * arms[..., _NEXT]
    out[:, 3:] = axes.transpose(0, 2, 1)
    return out


def pose_error(T_from: Array, T_to: Array) -> Array:
    """(N, 6) translation and rotation vector, base frame, that carry T_from to T_to (< pi apart)."""
    relative = (T_to[:, :3, :3] @ T_from[:, :3, :3].transpose(0, 2, 1)).reshape(-1, 9)
    axis = relative[:, (7, 2, 3)] - relative[:, (5, 6, 1)]
    sine = np.sqrt((axis * axis).sum(axis=-1)) / 2
    cosine = (relative[:, 0] + relative[:, 4] + relative[:, 8] - 1) / 2
    scale = np.where(sine > 1e-9, np.arctan2(sine, cosine) / np.maximum(2 * sine, 1e-12), 0.5)
    out = np.empty((len(relative), 6))
    np.subtract(T_to[:, :3, 3], T_from[:, :3, 3], out=out[:, :3])
    np.multiply(axis, scale[:, None], out=out[:, 3:])
    return out


def sample_postures(T_base_ee: Array, near: Array) -> Array:
    """All arm postures found for one hand pose over the null space, nearest to `near` first.

    Args:
        T_base_ee: (4, 4) hand pose.
        near: (7,) joint angles.

    Returns:
        (K, 7) joint angles within the limits, K = 0 where the pose is out of reach.
    """
    flange = T_base_ee.astype(np.float64) @ _hand_yaw_inverse()
    postures = np.asarray(frankik.ik_sample_q7(flange, near, sample_size=40, sample_interval=330.0)).reshape(
        -1, 7
    )
    inside = np.all((postures >= JOINT_LOWER) & (postures <= JOINT_UPPER), axis=-1)
    postures = postures[inside & np.all(np.isfinite(postures), axis=-1)]
    return postures[np.argsort(np.linalg.norm(postures - near, axis=-1), kind="stable")]


@functools.cache
def _hand_yaw_inverse() -> Array:
    c, s = np.cos(-HAND_YAW), np.sin(-HAND_YAW)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
