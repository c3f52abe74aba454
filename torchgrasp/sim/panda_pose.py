"""Where the Panda's shapes are at a given posture: what a camera sees of the robot."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from torchgrasp.sim import kinematics
from torchgrasp.sim.panda_tables import ARM_SHAPES, FINGER_SHAPES, HAND_SHAPES, hand_boxes

# Sizes as in `panda_tables.Shape`, in the order of the poses below.
ARM_SIZES = tuple(shape.size for shapes in ARM_SHAPES for shape in shapes)
HAND_SIZES = tuple(shape.size for shape in (*HAND_SHAPES, *FINGER_SHAPES, *FINGER_SHAPES))


def half_extents(size: tuple[float, ...]) -> NDArray:
    """(3,) half extents of the box that holds a shape, metres."""
    if len(size) == 3:
        return np.array(size) / 2
    radius, length = size
    return np.array((radius, radius, radius + length / 2))


@functools.cache
def _arm_frames() -> tuple[NDArray, NDArray]:
    """The link (S,) of each of the arm's shapes and its (S, 4, 4) pose in that link."""
    rows = [(link, shape.pose) for link, shapes in enumerate(ARM_SHAPES) for shape in shapes]
    return np.array([link for link, _ in rows]), np.stack([pose for _, pose in rows])


def arm_poses(q: NDArray) -> NDArray:
    """(7,) arm angles to the (S, 4, 4) poses of the shapes `ARM_SIZES` of links 0 to 7, base frame."""
    links, frames = _arm_frames()
    poses = np.concatenate((np.eye(4)[None], kinematics.link_poses(q[None])[0, :7]))
    return poses[links] @ frames


def hand_poses(T_base_ee: NDArray, fingers: NDArray) -> NDArray:
    """(4, 4) hand pose and (2,) finger positions to the (S, 4, 4) poses of `HAND_SIZES`, base frame."""
    return T_base_ee @ np.stack([pose for pose, _ in hand_boxes(*fingers.tolist())])
