"""The naive planner that others are measured against: straight in joint space to the best grasp."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from torchgrasp.errors import check_range
from torchgrasp.planning.goals import GoalChoice
from torchgrasp.planning.pacing import pace
from torchgrasp.planning.plan import Plan, PlanStatus
from torchgrasp.planning.planner import Planner, Query
from torchgrasp.sim import kinematics
from torchgrasp.sim.reach import ReachableGrasps


@dataclass(frozen=True)
class StraightPlanner(Planner):
    """Takes the cheapest grasp in reach and goes straight there, whatever is in the way.

    Attributes:
        choice: which grasp is the best.
        standoff: metres before the grasp that the way goes through; 0 for none.
        arrive: share of the horizon after which the hand is at the grasp.
    """

    choice: GoalChoice = field(default_factory=lambda: GoalChoice(max_reached=1))
    standoff: float = 0.08
    arrive: float = 0.85

    def __post_init__(self) -> None:
        check_range("standoff", self.standoff, 0.0, 0.3)
        check_range("arrive", self.arrive, 0.0, 1.0, open_low=True)

    def find_way(self, query: Query, grasps: ReachableGrasps) -> Plan:
        """See `Planner.find_way`."""
        goal, way = grasps.T_base_ee[0], [query.q]
        if self.standoff:
            before = goal.copy()
            before[:3, 3] -= self.standoff * before[:3, 2]
            way += list(kinematics.sample_postures(before, query.q)[:1])
        # The null space is searched around a posture: what is found around one may be missed around another.
        last = (*kinematics.sample_postures(goal, way[-1]), *kinematics.sample_postures(goal, query.q))
        if not last:
            return Plan(PlanStatus.REACH)
        way.append(last[0])
        steps = query.steps_to_arrive(self.arrive)
        path = pace(np.array(way), steps, query.control_period, at_most=query.steps_left)
        if path is None:
            return Plan(PlanStatus.STEPS)
        poses = kinematics.forward_kinematics(path)
        return Plan(PlanStatus.OK, grasps, self.choice.cost(query.target, grasps), 0, path, poses)
