"""The planner behind the feedback law: it proves the funnel's own way by a kinematic rollout."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from torchgrasp.objects.gripper import hand_blocked, lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import surface_points
from torchgrasp.planning.funnel import Funnel
from torchgrasp.planning.goals import GoalChoice
from torchgrasp.planning.plan import Plan, Planner, PlanStatus
from torchgrasp.sim import kinematics, tracking
from torchgrasp.sim.kinematics import Array


@dataclass(frozen=True)
class _Rollouts:
    """What became of K rollouts: joint paths (K, S + 1, 7), hand poses (K, S + 1, 4, 4), free (K,)."""

    q: Array
    T_base_ee: Array
    free: np.ndarray


@dataclass(frozen=True)
class FunnelPlanner(Planner):
    """Chooses grasps and proves the way to the best of them by a kinematic rollout of the funnel.

    Attributes:
        funnel: the law that is rolled out.
        choice: which grasps are goals.
        num_rollouts: how many goals are rolled out at once, until one way is free.
        blocked: penalty of a grasp whose way was found blocked from the start, metres of L_POSE.
        prove: False takes the goal set as it is, without a rollout, as an ablation.
    """

    funnel: Funnel = field(default_factory=Funnel)
    choice: GoalChoice = field(default_factory=GoalChoice)
    num_rollouts: int = 4
    blocked: float = 0.25
    prove: bool = True

    def plan(
        self, target: GraspObject, T_base_object: Array, q: Array, steps_left: int, horizon: int
    ) -> Plan:
        """See `Planner.plan`."""
        started = time.perf_counter()
        status, grasps = self.choice.choose(target, T_base_object, q)
        if status is not PlanStatus.OK:
            return Plan(status, seconds=time.perf_counter() - started)
        cost = self.choice.cost(target, grasps)
        if not self.prove:
            return Plan(status, grasps, cost, seconds=time.perf_counter() - started)
        tried = np.zeros(len(grasps), dtype=bool)
        for start in range(0, len(grasps), self.num_rollouts):
            batch = slice(start, start + self.num_rollouts)
            rollouts = self._roll_out(target, T_base_object, q, grasps.T_base_ee[batch], steps_left, horizon)
            tried[batch] = ~rollouts.free
            if rollouts.free.any():
                row = int(np.argmax(rollouts.free))
                toll = np.where(tried, self.blocked, 0.0)
                path = rollouts.q[row], rollouts.T_base_ee[row]
                seconds = time.perf_counter() - started
                return Plan(status, grasps, cost + toll, start + row, *path, seconds)
        return Plan(PlanStatus.BLOCKED, seconds=time.perf_counter() - started)

    def _roll_out(
        self, target: GraspObject, T_base_object: Array, q: Array, goals: Array, steps_left: int, horizon: int
    ) -> _Rollouts:
        """Follow the funnel to each of the goals (K, 4, 4) as the controller would."""
        path_q = np.empty((len(goals), steps_left + 1, 7))
        path = np.empty((len(goals), steps_left + 1, 4, 4))
        path_q[:, 0] = q
        path[:, 0] = kinematics.forward_kinematics(q[None])
        free = np.ones(len(goals), dtype=bool)
        for t in range(steps_left):
            left = np.full(len(goals), float(steps_left - t))
            path[:, t + 1] = self.funnel.next_pose(path[:, t], goals, left, horizon)
            path_q[:, t + 1], error = tracking.track_pose(path_q[:, t], path[:, t + 1], tolerance=1e-3)
            free &= error < 2e-3
        free &= (lowest_point(path[:, 1:]) > 0.0).all(axis=-1)
        free &= np.linalg.norm(path[:, -1, :3, 3] - goals[:, :3, 3], axis=-1) < 5e-3
        T_object_ee = np.linalg.solve(T_base_object, path[:, 1:].reshape(-1, 4, 4))
        touched = hand_blocked(surface_points(target), T_object_ee, approach=0.0)
        return _Rollouts(path_q, path, free & ~touched.reshape(len(goals), -1).any(axis=-1))
