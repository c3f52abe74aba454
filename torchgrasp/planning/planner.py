"""Grasp choice: the grasps of an object that the arm reaches by a clear way, the nearest first."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from torchgrasp.geometry import gripper_control_points
from torchgrasp.objects.gripper import hand_blocked, lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import surface_points
from torchgrasp.planning.funnel import Funnel
from torchgrasp.sim import kinematics, tracking
from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.reach import ReachableGrasps, clear_grasps, in_reach

_CONTROL_POINTS = gripper_control_points().numpy().astype(np.float64)


class PlanStatus(Enum):
    """Why there is or is not a plan."""

    OK = "a clear way to a grasp was found"
    NO_GRASPS = "the object has no grasps"
    TABLE = "every grasp would put the hand into the table"
    REACH = "no grasp is within the arm's reach"
    BLOCKED = "the way to every grasp in reach is blocked"

    @property
    def number(self) -> int:
        """What PLAN_STATUS holds."""
        return list(PlanStatus).index(self)


@dataclass(frozen=True)
class Plan:
    """What the planner found for one object where it lies.

    Attributes:
        status: whether there is a plan, or the reason why not.
        grasps: reachable grasps (row of the grasp set and pose), none where the status says so.
        penalty: (K,) metres added to a grasp's L_POSE distance when one is chosen.
    """

    status: PlanStatus
    grasps: ReachableGrasps
    penalty: Array = field(default_factory=lambda: np.empty(0))

    @property
    def ok(self) -> bool:
        """Whether there is a grasp to go for."""
        return self.status is PlanStatus.OK


def pose_distances(T_base_ee: Array, T_base_goals: Array) -> Array:
    """L_POSE, Eq. (2): from one hand pose (4, 4) to each of (K, 4, 4), (K,) metres."""
    difference = T_base_goals[:, :3, :] - T_base_ee[:3, :]
    homogeneous = np.concatenate((_CONTROL_POINTS, np.ones((len(_CONTROL_POINTS), 1))), axis=-1)
    return np.abs(difference @ homogeneous.T).sum(axis=1).mean(axis=-1)


@dataclass(frozen=True)
class GraspPlanner:
    """Chooses grasps and proves the way to the best of them by a kinematic rollout of the funnel.

    Attributes:
        funnel: the law that is rolled out.
        quality_weight: metres of L_POSE that a grasp of quality 1 is preferred by.
        clearance: metres above the table from which on the hand's height no longer counts.
        clearance_weight: metres of L_POSE that a metre less than `clearance` costs: a learner, which
            sees no table, must be taught to stay off it.
        max_reached: how many of the nearest grasps are solved for the arm.
        num_rollouts: how many of those are rolled out at once, until one way is free.
        blocked: penalty of a grasp whose way was found blocked from the start.
    """

    funnel: Funnel = field(default_factory=Funnel)
    quality_weight: float = 0.1
    clearance: float = 0.03
    clearance_weight: float = 2.0
    max_reached: int = 48
    num_rollouts: int = 4
    blocked: float = 0.25

    def plan(
        self, target: GraspObject, T_base_object: Array, q: Array, steps_left: int, horizon: int
    ) -> Plan:
        """Rank the grasps for a hand that stands at q with `steps_left` of `horizon` steps to go.

        Args:
            target: the object.
            T_base_object: (4, 4) its pose.
            q: (7,) arm angles.
            steps_left: until the fingers close.
            horizon: steps of the episode.

        Returns:
            A plan; never raises for an unlucky scene.
        """
        empty = ReachableGrasps(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))
        if not len(target.grasps):
            return Plan(PlanStatus.NO_GRASPS, empty)
        clear = clear_grasps(target, T_base_object)
        if not len(clear):
            return Plan(PlanStatus.TABLE, empty)
        T_base_ee = kinematics.forward_kinematics(q[None])[0]
        cost = pose_distances(T_base_ee, clear.T_base_ee) + self._cost(target, clear)
        order = np.argsort(cost, kind="stable")
        ranked = ReachableGrasps(clear.index[order], clear.T_base_ee[order])
        reached = in_reach(ranked, q, at_most=self.max_reached)
        if not len(reached):
            return Plan(PlanStatus.REACH, empty)
        free = self._prove(target, T_base_object, q, reached.T_base_ee, steps_left, horizon)
        if not (free > 0).any():
            return Plan(PlanStatus.BLOCKED, empty)
        toll = np.where(free < 0, self.blocked, 0.0)
        return Plan(PlanStatus.OK, reached, toll + self._cost(target, reached))

    def _cost(self, target: GraspObject, grasps: ReachableGrasps) -> Array:
        """(K,) metres of L_POSE that the grasps cost whatever the way to them."""
        quality = target.grasp_quality[grasps.index].astype(np.float64)
        low = np.maximum(0.0, self.clearance - lowest_point(grasps.T_base_ee))
        return self.clearance_weight * low - self.quality_weight * quality

    def _prove(
        self, target: GraspObject, T_base_object: Array, q: Array, goals: Array, steps_left: int, horizon: int
    ) -> np.ndarray:
        """(K,) 1 where the way to the goal is free, -1 where blocked, 0 where not tried.

        Goals (K, 4, 4) are tried a batch at a time until some way is free.
        """
        free = np.zeros(len(goals), dtype=np.int64)
        for start in range(0, len(goals), self.num_rollouts):
            batch = slice(start, start + self.num_rollouts)
            way = self._way_is_free(target, T_base_object, q, goals[batch], steps_left, horizon)
            free[batch] = np.where(way, 1, -1)
            if way.any():
                break
        return free

    def _way_is_free(
        self, target: GraspObject, T_base_object: Array, q: Array, goals: Array, steps_left: int, horizon: int
    ) -> np.ndarray:
        """(K,) whether hand and arm come through to each of the goals (K, 4, 4)."""
        q = np.tile(q, (len(goals), 1))
        free = np.ones(len(goals), dtype=bool)
        T_base_ee = kinematics.forward_kinematics(q)
        path = np.empty((len(goals), steps_left, 4, 4))
        for t in range(steps_left):
            left = np.full(len(goals), float(steps_left - t))
            T_base_ee = self.funnel.next_pose(T_base_ee, goals, left, horizon)
            q, error = tracking.track_pose(q, T_base_ee, tolerance=1e-3)
            free &= error < 2e-3
            path[:, t] = T_base_ee
        free &= (lowest_point(path) > 0.0).all(axis=-1)
        arrived = np.linalg.norm(path[:, -1, :3, 3] - goals[:, :3, 3], axis=-1) < 5e-3
        T_object_ee = np.linalg.solve(T_base_object, path.reshape(-1, 4, 4))
        touched = hand_blocked(surface_points(target), T_object_ee, approach=0.0)
        return free & arrived & ~touched.reshape(len(goals), -1).any(axis=-1)
