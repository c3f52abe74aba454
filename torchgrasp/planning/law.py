"""How the expert goes on from where the hand is: by a law that needs no path, or along a planned path."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from torchgrasp.errors import check_range
from torchgrasp.planning.plan import Plan
from torchgrasp.sim.kinematics import Array, pose_error


def steps_after(share: float, horizon: int) -> int:
    """Control steps of `horizon` that are left after a share of it."""
    return int(np.floor((1.0 - share) * horizon + 1e-9))


@dataclass(frozen=True)
class Course:
    """What is pursued in one world.

    Attributes:
        plan: the plan that holds.
        T_base_goal: (4, 4) the grasp gone for.
        age: control steps since the plan was made.
        shift: (4, 4) what moved the object since then, in the base: identity where it lies still.
    """

    plan: Plan
    T_base_goal: Array
    age: int
    shift: Array


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

    The path moves with the object, until that has moved so far that a new plan is made.

    Attributes:
        max_offset: metres that the hand may be off the path before a new one is planned.
        max_angle: the same, radians.
        max_translation, max_rotation: of one step, metres and radians: labels of a hand that is off a path
            to which there is no other stay inside the actions' bounds.
    """

    max_offset: float = 0.015
    max_angle: float = 0.12
    max_translation: float = 0.055
    max_rotation: float = 0.45
    any_goal = False

    def __post_init__(self) -> None:
        check_range("max_offset", self.max_offset, 0.0, np.inf)
        check_range("max_angle", self.max_angle, 0.0, np.inf)
        check_range("max_translation", self.max_translation, 0.0, np.inf, open_low=True)
        check_range("max_rotation", self.max_rotation, 0.0, np.inf, open_low=True)

    def steer(self, T_base_ee: Array, courses: Sequence[Course], steps_left: Array, horizon: int) -> Array:
        """See `Law.steer`."""
        due = np.array([self._due(course, course.age + 1) for course in courses]).reshape(-1, 4, 4)
        way = pose_error(T_base_ee, due)
        moved = self.max_translation / np.maximum(np.linalg.norm(way[:, :3], axis=-1), 1e-9)
        turned = self.max_rotation / np.maximum(np.linalg.norm(way[:, 3:], axis=-1), 1e-9)
        share = np.minimum(1.0, np.minimum(moved, turned))[:, None]
        out = due.copy()
        out[:, :3, 3] = T_base_ee[:, :3, 3] + share * way[:, :3]
        turn = Rotation.from_rotvec(share * way[:, 3:]).as_matrix()
        out[:, :3, :3] = turn @ T_base_ee[:, :3, :3]
        return out

    def is_lost(self, T_base_ee: Array, course: Course) -> bool:
        """See `Law.is_lost`."""
        due = self._due(course, course.age)
        (way,) = pose_error(T_base_ee[None], due[None])
        offset, turn = np.linalg.norm(way[:3]), np.linalg.norm(way[3:])
        return bool(offset > self.max_offset or turn > self.max_angle)

    @staticmethod
    def _due(course: Course, step: int) -> Array:
        path = course.plan.T_base_ee
        return course.shift @ path[min(step, len(path) - 1)]
