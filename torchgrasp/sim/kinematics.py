"""Kinematics of the Franka Emika Panda's arm, batched in numpy.

float64 and one matrix at a time inside numpy's loops, so that a result never depends on how many
rows are computed beside it. Poses are those of the hand link (frame `ee`) in the robot base.
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
TCP_OFFSET = 0.1034
JOINT_LOWER = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
JOINT_UPPER = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
JOINT_VELOCITY = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
JOINT_EFFORT = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])
READY_POSTURE = np.array([0.0, np.pi / 8, 0.0, -5 * np.pi / 8, 0.0, 3 * np.pi / 4, np.pi / 4])


def _rotation_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


@functools.cache
def _origins() -> Array:
    """(7, 4, 4) fixed transforms of JOINT_ORIGINS."""
    frames = np.tile(np.eye(4), (7, 1, 1))
    for frame, (xyz, roll) in zip(frames, JOINT_ORIGINS, strict=True):
        frame[:3, :3], frame[:3, 3] = _rotation_x(roll), xyz
    return frames


@functools.cache
def hand_in_link7() -> Array:
    """(4, 4) pose of the hand link in link 7: the flange's length, then the hand's yaw."""
    c, s = np.cos(HAND_YAW), np.sin(HAND_YAW)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, FLANGE_LENGTH], [0, 0, 0, 1.0]])


def link_poses(q: Array) -> Array:
    """(N, 7) joint angles to (N, 8, 4, 4) poses of links 1 to 7 and of the hand, in the base."""
    q = np.asarray(q, dtype=np.float64)
    c, s = np.cos(q), np.sin(q)
    origins = _origins()
    x, y = origins[..., 0], origins[..., 1]
    local = np.empty((len(q), 7, 4, 4))
    local[..., 0] = x * c[..., None] + y * s[..., None]
    local[..., 1] = y * c[..., None] - x * s[..., None]
    local[..., 2:] = origins[..., 2:]
    poses = np.empty((len(q), 8, 4, 4))
    poses[:, 0] = local[:, 0]
    for i in range(1, 7):
        poses[:, i] = poses[:, i - 1] @ local[:, i]
    poses[:, 7] = poses[:, 6] @ hand_in_link7()
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
    return np.concatenate((np.cross(axes, arms), axes), axis=-1).transpose(0, 2, 1)


def pose_error(T_from: Array, T_to: Array) -> Array:
    """(N, 6) translation and rotation vector, base frame, that carry T_from to T_to (< pi apart)."""
    relative = T_to[:, :3, :3] @ T_from[:, :3, :3].transpose(0, 2, 1)
    axis = np.stack(
        (
            relative[:, 2, 1] - relative[:, 1, 2],
            relative[:, 0, 2] - relative[:, 2, 0],
            relative[:, 1, 0] - relative[:, 0, 1],
        ),
        axis=-1,
    )
    sine = np.linalg.norm(axis, axis=-1) / 2
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
    scale = np.where(sine > 1e-9, np.arctan2(sine, cosine) / np.maximum(2 * sine, 1e-12), 0.5)
    return np.concatenate((T_to[:, :3, 3] - T_from[:, :3, 3], axis * scale[:, None]), axis=-1)


def track_pose(
    q: Array, T_base_ee: Array, *, iterations: int = 12, damping: float = 1e-3, tolerance: float = 1e-5
) -> tuple[Array, Array]:
    """Inverse kinematics that continues smoothly from q: damped least squares within the limits.

    Args:
        q: (N, 7) joint angles to start from.
        T_base_ee: (N, 4, 4) hand poses to reach.
        iterations: Newton steps at most.
        damping: of the least squares; small, because targets lie a step away.
        tolerance: of the pose error (metres and radians) at which a row stops.

    Returns:
        (N, 7) joint angles within the limits and the (N,) largest component of the error left.
    """
    q = np.clip(q, JOINT_LOWER, JOINT_UPPER)
    active = np.arange(len(q))
    left = np.zeros(len(q))
    for _ in range(iterations + 1):
        poses = link_poses(q[active])
        error = pose_error(poses[:, 7], T_base_ee[active])
        left[active] = np.abs(error).max(axis=-1)
        keep = left[active] > tolerance
        if not keep.any():
            break
        active, error, poses = active[keep], error[keep], poses[keep]
        q[active] = _least_squares_step(q[active], jacobian(poses), error, damping)
    return q, left


def _least_squares_step(q: Array, j: Array, error: Array, damping: float) -> Array:
    """One damped step; joints that a limit stops are locked and the others take over."""
    free = np.ones_like(q)
    for _ in range(3):
        jf = j * free[:, None, :]
        gram = jf @ jf.transpose(0, 2, 1) + damping**2 * np.eye(6)
        step = (jf.transpose(0, 2, 1) @ np.linalg.solve(gram, error[..., None]))[..., 0]
        blocked = ((q + step > JOINT_UPPER) | (q + step < JOINT_LOWER)) & (free > 0)
        if not blocked.any():
            break
        free[blocked] = 0.0
    return np.clip(q + step, JOINT_LOWER, JOINT_UPPER)


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
