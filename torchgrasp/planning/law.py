"""How the expert goes on from where the hand is: by a law that needs no path, or along a planned path."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from torchgrasp.errors import check_range
from torchgrasp.planning.plan import Plan
from torchgrasp.sim.kinematics import Array


@dataclass(frozen=True)
class Course:
    """What is pursued in one world.

    Attributes:
        plan: the plan that holds.
        T_base_goal: (4, 4) the grasp gone for.
        age: control steps since the plan was made.
    """

    plan: Plan
    T_base_goal: Array
    age: int


class Law(ABC):
    """From a state and a plan to the hand pose one control step on.

    Attributes:
        any_goal: whether the nearest grasp of the goal set may be pursued, or only the planned one.
    """

    any_goal: bool = True

    @abstractmethod
    def steer(self, T_base_ee: Array, courses: Sequence[Course], steps_left: Array, horizon: int) -> Array:
        """The hand pose one step on.

        Args:
            T_base_ee: (N, 4, 4) hand poses.
            courses: N.
            steps_left: (N,) steps until the fingers close, at least 1.
            horizon: T, steps of the whole episode.

        Returns:
            (N, 4, 4) hand poses.
        """

    def is_lost(self, T_base_ee: Array, course: Course) -> bool:
        """Whether the hand (4, 4) has left the course so far that a new plan is due."""
        return False


@dataclass(frozen=True)
class PathFollower(Law):
    """Leads the hand back to the planned path, to the pose that is due one step on.

    Attributes:
        max_offset: metres that the hand may be off the path before a new one is planned.
        max_angle: the same, radians.
    """

    max_offset: float = 0.015
    max_angle: float = 0.12
    any_goal = False

    def __post_init__(self) -> None:
        check_range("path_follower.max_offset", self.max_offset, 0.0, np.inf)
        check_range("path_follower.max_angle", self.max_angle, 0.0, np.inf)

    def steer(self, T_base_ee: Array, courses: Sequence[Course], steps_left: Array, horizon: int) -> Array:
        """See `Law.steer`."""
        return np.array([self._due(course, course.age + 1) for course in courses]).reshape(-1, 4, 4)

    def is_lost(self, T_base_ee: Array, course: Course) -> bool:
        """See `Law.is_lost`."""
        due = self._due(course, course.age)
        turn = Rotation.from_matrix(due[:3, :3].T @ T_base_ee[:3, :3]).magnitude()
        offset = np.linalg.norm(T_base_ee[:3, 3] - due[:3, 3])
        return bool(offset > self.max_offset or turn > self.max_angle)

    @staticmethod
    def _due(course: Course, step: int) -> Array:
        path = course.plan.T_base_ee
        return path[min(step, len(path) - 1)]
