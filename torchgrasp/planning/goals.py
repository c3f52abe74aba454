"""The goal set: the grasps of an object that the arm reaches clear of the table, the nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchgrasp.errors import check_range, check_whole
from torchgrasp.geometry import gripper_control_points
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.plan import PlanStatus, no_grasps
from torchgrasp.sim import kinematics
from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.reach import ReachableGrasps, clear_grasps, in_reach

_CONTROL_POINTS = gripper_control_points().numpy().astype(np.float64)


def pose_distances(T_base_ee: Array, T_base_goals: Array) -> Array:
    """L_POSE, Eq. (2): from one hand pose (4, 4) to each of (K, 4, 4), (K,) metres."""
    difference = T_base_goals[:, :3, :] - T_base_ee[:3, :]
    homogeneous = np.concatenate((_CONTROL_POINTS, np.ones((len(_CONTROL_POINTS), 1))), axis=-1)
    return np.abs(difference @ homogeneous.T).sum(axis=1).mean(axis=-1)


@dataclass(frozen=True)
class GoalChoice:
    """Which grasps are goals, and what each costs whatever the way to it.

    Attributes:
        quality_weight: metres of L_POSE that a grasp of quality 1 is preferred by.
        clearance: metres above the table from which on the hand's height no longer counts.
        clearance_weight: metres of L_POSE that a metre less than `clearance` costs: a learner, which
            sees no table, must be taught to stay off it.
        loyalty: metres of L_POSE by which another grasp must be cheaper than the one pursued so far: labels
            that change their mind teach nothing.
        max_reached: how many of the nearest grasps are solved for the arm.
    """

    quality_weight: float = 0.1
    clearance: float = 0.03
    clearance_weight: float = 2.0
    loyalty: float = 0.1
    max_reached: int = 16

    def __post_init__(self) -> None:
        for name in ("quality_weight", "clearance", "clearance_weight", "loyalty"):
            check_range(name, getattr(self, name), 0.0, np.inf)
        check_whole("max_reached", self.max_reached, 1)

    def choose(
        self, target: GraspObject, T_base_object: Array, q: Array, pursued: int = -1
    ) -> tuple[PlanStatus, ReachableGrasps]:
        """The goal set for an arm at q (7,), the cheapest first; the status tells why it is empty.

        `pursued` is the grasp's row in the object's set that was gone for so far, -1 for none.
        """
        if not len(target.grasps):
            return PlanStatus.NO_GRASPS, no_grasps()
        clear = clear_grasps(target, T_base_object)
        if not len(clear):
            return PlanStatus.TABLE, no_grasps()
        T_base_ee = kinematics.forward_kinematics(q[None])[0]
        cost = pose_distances(T_base_ee, clear.T_base_ee) + self.cost(target, clear, pursued)
        order = np.argsort(cost, kind="stable")
        ranked = ReachableGrasps(clear.index[order], clear.T_base_ee[order])
        reached = in_reach(ranked, q, at_most=self.max_reached)
        return (PlanStatus.OK if len(reached) else PlanStatus.REACH), reached

    def cost(self, target: GraspObject, grasps: ReachableGrasps, pursued: int = -1) -> Array:
        """(K,) metres of L_POSE that the grasps cost whatever the way to them."""
        quality = target.grasp_quality[grasps.index].astype(np.float64)
        low = np.maximum(0.0, self.clearance - lowest_point(grasps.T_base_ee))
        faithful = self.loyalty * (grasps.index == pursued)
        return self.clearance_weight * low - self.quality_weight * quality - faithful
