"""The planner behind the feedback law: it proves the funnel's own way by a kinematic rollout."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from torchgrasp.errors import check_range, check_whole
from torchgrasp.planning.clearance import Clearance
from torchgrasp.planning.contact import arm_is_free, hand_is_free, starts_inside
from torchgrasp.planning.funnel import Funnel
from torchgrasp.planning.goals import GoalChoice
from torchgrasp.planning.joint_path import drive_along
from torchgrasp.planning.plan import Plan, PlanStatus
from torchgrasp.planning.planner import Planner, Query
from torchgrasp.sim import kinematics
from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.reach import ReachableGrasps


@dataclass(frozen=True)
class FunnelPlanner(Planner):
    """Chooses grasps and proves the way to the best of them by a kinematic rollout of the funnel.

    Attributes:
        funnel: the law that is rolled out.
        choice: which grasps are goals.
        num_rollouts: how many goals are rolled out at once, until one way is free.
        blocked: penalty of a grasp whose way was found blocked from the start, metres of L_POSE.
        budget: seconds after which no further way is tried; a plan that is cut short by it is not repeatable.
        prove: False takes the goal set as it is, without a rollout, as an ablation.
    """

    funnel: Funnel = field(default_factory=Funnel)
    choice: GoalChoice = field(default_factory=lambda: GoalChoice(max_reached=48, loyalty=0.01))
    num_rollouts: int = 4
    blocked: float = 0.25
    budget: float = np.inf
    prove: bool = True

    def __post_init__(self) -> None:
        check_whole("num_rollouts", self.num_rollouts, 1)
        check_range("blocked", self.blocked, 0.0, np.inf)
        check_range("budget", self.budget, 0.0, np.inf)

    @property
    def gives_path(self) -> bool:
        """See `Planner.gives_path`: a way that was not rolled out is not known."""
        return self.prove

    def find_way(self, query: Query, grasps: ReachableGrasps) -> Plan:
        """See `Planner.find_way`."""
        target, q, cost = query.target, query.q, self.choice.cost(query.target, grasps)
        clearance = Clearance.of(target, query.T_base_object)
        if starts_inside(target, query.T_base_object, q, clearance):
            return Plan(PlanStatus.START)
        if not self.prove:
            return Plan(PlanStatus.OK, grasps, cost)
        for start in range(0, len(grasps), self.num_rollouts):
            if time.perf_counter() - query.started > self.budget:
                return Plan(PlanStatus.TIME)
            goals = grasps.T_base_ee[start : start + self.num_rollouts]
            ways = self._roll_out(q, goals, query.steps_left, query.horizon)
            arrives = np.linalg.norm(ways[:, -1, :3, 3] - goals[:, :3, 3], axis=-1) < 5e-3
            for row, free in enumerate(arrives & hand_is_free(target, query.T_base_object, ways)):
                path = drive_along(q, ways[row]) if free else None
                if path is not None and arm_is_free(clearance, path[None])[0]:
                    return Plan(PlanStatus.OK, grasps, cost, start + row, path, ways[row])
                cost[start + row] += self.blocked
        return Plan(PlanStatus.BLOCKED)

    def _roll_out(self, q: Array, goals: Array, steps_left: int, horizon: int) -> Array:
        """(K, steps_left + 1, 4, 4) the funnel's ways from q to goals (K, 4, 4)."""
        ways = np.empty((len(goals), steps_left + 1, 4, 4))
        ways[:, 0] = kinematics.forward_kinematics(q[None])
        for step in range(steps_left):
            left = np.full(len(goals), float(steps_left - step))
            ways[:, step + 1] = self.funnel.next_pose(ways[:, step], goals, left, horizon)
        return ways
