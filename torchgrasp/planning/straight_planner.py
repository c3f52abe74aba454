"""The naive planner that others are measured against: straight in joint space to the best grasp."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from torchgrasp.errors import check_range
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.goals import GoalChoice
from torchgrasp.planning.pacing import pace
from torchgrasp.planning.plan import Plan, Planner, PlanStatus, steps_to_arrive
from torchgrasp.sim import kinematics
from torchgrasp.sim.kinematics import Array


@dataclass(frozen=True)
class StraightPlanner(Planner):
    """Takes the cheapest grasp in reach and goes straight there, whatever is in the way.

    Attributes:
        choice: which grasp is the best.
        standoff: metres before the grasp that the way goes through; 0 for none.
        arrive: share of the horizon after which the hand is at the grasp.
        control_period: seconds of a control step.
    """

    choice: GoalChoice = field(default_factory=lambda: GoalChoice(max_reached=1))
    standoff: float = 0.08
    arrive: float = 0.85
    control_period: float = 0.15

    def __post_init__(self) -> None:
        check_range("straight_planner.standoff", self.standoff, 0.0, 0.3)
        check_range("straight_planner.arrive", self.arrive, 0.0, 1.0, open_low=True)

    def plan(
        self,
        target: GraspObject,
        T_base_object: Array,
        q: Array,
        steps_left: int,
        horizon: int,
        *,
        pursued: int = -1,
    ) -> Plan:
        """See `Planner.plan`."""
        started = time.perf_counter()
        status, grasps = self.choice.choose(target, T_base_object, q, pursued)
        if status is not PlanStatus.OK:
            return Plan(status, seconds=time.perf_counter() - started)
        goal = grasps.T_base_ee[0]
        way = [q]
        if self.standoff:
            before = goal.copy()
            before[:3, 3] -= self.standoff * before[:3, 2]
            way += list(kinematics.sample_postures(before, q)[:1])
        way.append(kinematics.sample_postures(goal, way[-1])[0])
        steps = steps_to_arrive(steps_left, horizon, self.arrive)
        path = pace(np.array(way), steps, self.control_period, at_most=steps_left)
        if path is None:
            return Plan(PlanStatus.STEPS, seconds=time.perf_counter() - started)
        poses, penalty = kinematics.forward_kinematics(path), self.choice.cost(target, grasps, pursued)
        return Plan(status, grasps, penalty, 0, path, poses, time.perf_counter() - started)
