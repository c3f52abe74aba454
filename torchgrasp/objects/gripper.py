"""The open Panda hand as boxes in the ee frame: what must be clear for a grasp.

Sizes are the robot's own (franka_ros). Each box is swept backwards along the approach, so that one
test answers for the grasp itself and for the straight way to it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAX_OPENING = 0.08
PAD_CENTRE = 0.10365  # z of the pads' middle
PAD_HALF = (0.00875, 0.00925)  # half extents of a pad's face along x and z
_FINGER = 0.0584  # z of the finger joints

TABLE_CLEARANCE = 0.004  # metres of the open hand above the table at a grasp that may be taken
MIN_CLEAR_GRASPS = 8  # that a resting pose must leave clear of the table to be used

# (half extent along x, inner |y|, outer |y|, rear z, front z); fingers open at |y| = 0.04. The
# finger's slanted middle is taken at its bounding box.
_BOXES = (
    (0.0315, -1.0, 0.102, -0.026, 0.066),  # hand body
    (0.011, 0.04 + 0.011, 0.04 + 0.026, _FINGER + 0.001, _FINGER + 0.021),  # mount
    (0.011, 0.04 + 0.0024, 0.04 + 0.0112, _FINGER + 0.0003, _FINGER + 0.0041),  # sledge
    (0.00875, 0.04 + 0.007, 0.04 + 0.0249, _FINGER + 0.0167, _FINGER + 0.0400),  # slanted middle
    (0.00875, 0.04, 0.04 + 0.0152, _FINGER + 0.036, _FINGER + 0.0545),  # pad
)


def hand_blocked(
    points: NDArray, poses: NDArray, *, approach: float = 0.08, margin: float = 0.0, chunk: int = 512
) -> NDArray[np.bool_]:
    """Whether points (N, 3) of an object stand in the open hand's way, (B,) for poses (B, 4, 4).

    Args:
        points: samples of the object's surface, object frame.
        poses: `T_object_ee`.
        approach: metres of straight approach along z that must be clear as well.
        margin: metres by which the boxes are grown; the fingers' inner faces keep their place less
            half of it, because an object of 7.5 cm leaves 2.5 mm on each side.
        chunk: poses tested at once, which bounds the memory.
    """
    cloud = np.ascontiguousarray(points.T, np.float32)
    blocked = np.zeros(len(poses), bool)
    for start in range(0, len(poses), chunk):
        block = poses[start : start + chunk].astype(np.float32)
        x, y, z = (_coordinate(cloud, block, axis) for axis in range(3))
        x, y = np.abs(x, out=x), np.abs(y, out=y)
        hit = np.zeros(x.shape, bool)
        for half_x, inner, outer, rear, front in _BOXES:
            inside = (x < half_x + margin) & (y < outer + margin) & (z < front + margin)
            inside &= (y > inner - margin / 2) & (z > rear - margin - approach)
            hit |= inside
        blocked[start : start + chunk] = hit.any(1)
    return blocked


def hand_boxes() -> list[tuple[float, float, float, float]]:
    """The open hand's boxes as `lowest_point` counts them: half x, outer y, rear z, front z, metres."""
    return [(half_x, outer, rear, front) for half_x, _, outer, rear, front in _BOXES]


def clear_of_table(
    T_world_ee: NDArray, *, approach: float = 0.08, margin: float = 0.005
) -> NDArray[np.bool_]:
    """Whether the open hand stays `margin` metres above z = 0 at the grasp and on its way, (B,).

    Args:
        T_world_ee: (B, 4, 4) grasps of an object at rest on the table z = 0.
        approach: metres of straight approach.
        margin: metres.
    """
    return lowest_point(T_world_ee, approach=approach) > margin


def lowest_point(T_world_ee: NDArray, *, approach: float = 0.0) -> NDArray:
    """(*,) height above z = 0, metres, of the lowest corner of the open hand at (*, 4, 4) poses.

    Args:
        T_world_ee: (*, 4, 4) poses of the hand.
        approach: metres of straight approach that count as well.
    """
    x, y, z = (T_world_ee[..., 2, axis] for axis in range(3))
    lowest = [
        -half_x * np.abs(x) - outer * np.abs(y) + np.minimum(z * (rear - approach), z * front)
        for half_x, _, outer, rear, front in _BOXES
    ]
    return T_world_ee[..., 2, 3] + np.min(lowest, axis=0)


def _coordinate(cloud: NDArray, poses: NDArray, axis: int) -> NDArray:
    """One coordinate in the ee frame, (B, N), of a (3, N) cloud."""
    column = poses[:, :3, axis]
    return column @ cloud - (column * poses[:, :3, 3]).sum(1, keepdims=True)


def pad_rays(poses: NDArray, *, per_axis: int = 7) -> tuple[NDArray, NDArray]:
    """Rays from the open pads' faces towards each other: origins and directions (B, 2, R, 3).

    Side 0 is the finger at +y. R = per_axis**2 rays on a grid that reaches the face's edges,
    where an object that curves towards the hand is met first.
    """
    steps = np.linspace(-0.98, 0.98, per_axis)
    x, z = np.meshgrid(steps * PAD_HALF[0], steps * PAD_HALF[1] + PAD_CENTRE, indexing="ij")
    side = np.array((1.0, -1.0))[:, None]
    y = np.broadcast_to(side * MAX_OPENING / 2, (2, per_axis**2))
    local = np.stack((np.broadcast_to(x.ravel(), y.shape), y, np.broadcast_to(z.ravel(), y.shape)), axis=-1)
    origins = np.einsum("bij,srj->bsri", poses[:, :3, :3], local) + poses[:, None, None, :3, 3]
    directions = -side[None, :, :, None] * poses[:, None, None, :3, 1]
    return origins, np.broadcast_to(directions, origins.shape)
