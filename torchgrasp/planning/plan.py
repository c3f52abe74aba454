"""What a planner answers: a path to a grasp, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.reach import ReachableGrasps

# What PLAN_STATUS holds where the policy that acted has no planner.
NO_PLANNER = -1


class PlanStatus(Enum):
    """Why there is or is not a plan."""

    OK = "a clear way to a grasp was found"
    NO_GRASPS = "the object has no grasps"
    TABLE = "every grasp would put the hand into the table"
    REACH = "no grasp is within the arm's reach"
    BLOCKED = "the way to every grasp in reach is blocked"
    START = "the arm is in collision where it starts"
    STEPS = "no clear way is short enough for the steps left"
    TIME = "the time budget was spent before a clear way was found"

    @property
    def number(self) -> int:
        """What PLAN_STATUS holds."""
        return list(PlanStatus).index(self)

    @property
    def reason(self) -> str:
        """The status in words."""
        return self.value


def no_grasps() -> ReachableGrasps:
    """The empty goal set."""
    return ReachableGrasps(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))


@dataclass(frozen=True)
class Plan:
    """What a planner found for one object where it lies.

    Attributes:
        status: whether there is a plan, or the reason why not.
        grasps: the goal set: K reachable grasps (row of the grasp set and pose), none where the status
            says so.
        penalty: (K,) metres added to a grasp's L_POSE distance when the nearest is chosen.
        chosen: row of `grasps` that the path ends at, -1 without a path.
        q: (S + 1, 7) the joint path, from the posture asked about to the grasp, a control step apart.
        T_base_ee: (S + 1, 4, 4) the hand poses along it.
        seconds: what the plan took.
    """

    status: PlanStatus
    grasps: ReachableGrasps = field(default_factory=no_grasps)
    penalty: Array = field(default_factory=lambda: np.empty(0))
    chosen: int = -1
    q: Array = field(default_factory=lambda: np.empty((0, 7)))
    T_base_ee: Array = field(default_factory=lambda: np.empty((0, 4, 4)))
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether there is a grasp to go for."""
        return self.status is PlanStatus.OK

    @property
    def reason(self) -> str:
        """Why there is or is not a plan, in words."""
        return self.status.reason

    @property
    def T_base_goal(self) -> Array:
        """(4, 4) the grasp that the path ends at; raises ValueError without a plan."""
        if self.chosen < 0:
            raise ValueError(f"There is no goal: {self.reason}.")
        return self.grasps.T_base_ee[self.chosen]
