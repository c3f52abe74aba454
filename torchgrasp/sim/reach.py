"""Where the hand can go: clear of the table, within the arm's reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchgrasp.objects.gripper import TABLE_CLEARANCE, lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import kinematics


@dataclass(frozen=True)
class ReachableGrasps:
    """Grasps that one arm can take of one object where it lies.

    Attributes:
        index: (K,) rows of the object's grasp set.
        T_base_ee: (K, 4, 4) hand poses.
        postures: of each, where `in_reach` solved for them, the arm's (P_i, 7), the nearest first.
    """

    index: np.ndarray
    T_base_ee: np.ndarray
    postures: tuple[np.ndarray, ...] = ()

    def __len__(self) -> int:
        return len(self.index)


def clear_grasps(target: GraspObject, T_base_object: np.ndarray) -> ReachableGrasps:
    """The object's grasps at which the open hand stands clear of the table."""
    T_base_ee = T_base_object @ target.grasps.astype(np.float64)
    index = np.flatnonzero(lowest_point(T_base_ee) > TABLE_CLEARANCE)
    return ReachableGrasps(index, T_base_ee[index])


def in_reach(grasps: ReachableGrasps, near: np.ndarray, *, at_most: int | None = None) -> ReachableGrasps:
    """Those of the grasps for which the arm has a posture.

    Args:
        grasps: candidates, the best first.
        near: (7,) posture around which the null space is searched.
        at_most: stop after so many.
    """
    kept: dict[int, np.ndarray] = {}
    for row, pose in enumerate(grasps.T_base_ee):
        if len(kept) == at_most:
            break
        postures = kinematics.sample_postures(pose, near)
        if len(postures):
            kept[row] = postures
    rows = list(kept)
    return ReachableGrasps(grasps.index[rows], grasps.T_base_ee[rows], tuple(kept.values()))
