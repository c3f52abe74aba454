"""What every planner is asked, and how it is asked."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.goals import GoalChoice
from torchgrasp.planning.law import steps_after
from torchgrasp.planning.plan import Plan, PlanStatus
from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.reach import ReachableGrasps


@dataclass(frozen=True)
class Query:
    """One question to a planner; the arguments of `Planner.plan`, and when they were asked.

    Attributes:
        target: the object.
        T_base_object: (4, 4) its pose.
        q: (7,) arm angles, radians.
        steps_left: control steps until the fingers close.
        horizon: control steps of the whole episode.
        pursued: row of the object's grasp set that was gone for so far, -1 for none.
        control_period: seconds of a control step.
        started: reading of `time.perf_counter`.
    """

    target: GraspObject
    T_base_object: Array
    q: Array
    steps_left: int
    horizon: int
    pursued: int
    control_period: float
    started: float

    def steps_to_arrive(self, share: float) -> int:
        """Control steps until a share of the horizon is over, at least 1."""
        return max(1, self.steps_left - steps_after(share, self.horizon))


class Planner(ABC):
    """Finds a way of the arm to a grasp of an object whose shape and pose are known (Sec. 3.3).

    Attributes:
        choice: which grasps are goals.
    """

    choice: GoalChoice

    @property
    def gives_path(self) -> bool:
        """Whether its plans hold a path, and not goals alone."""
        return True

    def plan(
        self,
        target: GraspObject,
        T_base_object: Array,
        q: Array,
        steps_left: int,
        horizon: int,
        *,
        pursued: int = -1,
        control_period: float = 0.15,
    ) -> Plan:
        """Plan for an arm that stands at q with `steps_left` of `horizon` steps to go.

        Args:
            target: the object.
            T_base_object: (4, 4) its pose.
            q: (7,) arm angles, radians.
            steps_left: control steps until the fingers close, at least 1.
            horizon: control steps of the whole episode.
            pursued: row of the object's grasp set that was gone for so far, -1 for none: it is preferred by
                `GoalChoice.loyalty`.
            control_period: seconds of a control step, in which joints turn no further than they may.

        Returns:
            A plan, whose status tells why where there is none; never raises for an unlucky scene.
        """
        started = time.perf_counter()
        query = Query(target, T_base_object, q, steps_left, horizon, pursued, control_period, started)
        status, grasps = self.choice.choose(target, T_base_object, q, pursued)
        plan = self.find_way(query, grasps) if status is PlanStatus.OK else Plan(status)
        return replace(plan, seconds=time.perf_counter() - started)

    @abstractmethod
    def find_way(self, query: Query, grasps: ReachableGrasps) -> Plan:
        """The plan, but for its time, where there is a goal set: K > 0 `grasps`, the cheapest first."""
