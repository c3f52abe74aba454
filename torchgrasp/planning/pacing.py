"""From a path to control steps: even effort along it, within the arm's speed and the actions' bounds."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.sim.kinematics import JOINT_VELOCITY, Array, forward_kinematics, pose_error

# Shares of the limits that a plan uses: the rest is for the controller to catch up with.
_JOINTS, _HAND = 0.9, 0.9
_PIECE = 0.05  # radians of a joint


def effort(path: Array, control_period: float) -> Array:
    """(N - 1,) control steps that each piece of a joint path (N, 7) takes at full speed."""
    joints = np.abs(np.diff(path, axis=0)) / (_JOINTS * JOINT_VELOCITY * control_period)
    poses = forward_kinematics(path)
    hand = np.abs(pose_error(poses[:-1], poses[1:]))
    reach = _HAND * np.array((ACTION_BOUND[0], ACTION_BOUND[3]))
    moved = np.linalg.norm(hand[:, :3], axis=-1) / reach[0], np.linalg.norm(hand[:, 3:], axis=-1) / reach[1]
    return np.maximum(joints.max(axis=-1), np.maximum(*moved))


def pace(path: Array, steps: int, control_period: float, *, at_most: int | None = None) -> Array | None:
    """(S + 1, 7) the path (N, 7) a control step apart, each step of the same effort.

    Args:
        path: postures, the first where the arm stands.
        steps: S, more where the arm's limits ask for more.
        control_period: seconds of a step.
        at_most: the largest S that will do; None for any.

    Returns:
        None where `at_most` steps are too few for the limits.
    """
    path = _refined(path)
    spent = np.concatenate(([0.0], np.cumsum(effort(path, control_period))))
    steps = max(steps, int(np.ceil(spent[-1] - 1e-9)))
    if at_most is not None and steps > at_most:
        return None
    due = np.linspace(0.0, spent[-1], steps + 1)
    return np.stack([np.interp(due, spent, path[:, joint]) for joint in range(7)], axis=-1)


def _refined(path: Array) -> Array:
    """The same path in pieces so short that a chord of the hand's arc is as long as the arc."""
    pieces = [path[:1]]
    for start, end in pairwise(path):
        count = max(1, int(np.ceil(np.abs(end - start).max() / _PIECE)))
        pieces.append(start + np.arange(1, count + 1)[:, None] / count * (end - start))
    return np.concatenate(pieces)
