"""A feedback law towards a grasp: paced over the horizon, through a standoff that closes like a funnel.

The hand heads for a point behind the grasp as long as it is misaligned, and the point moves up to
the grasp as the misalignment goes: from any state there is one smooth way, no stored path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from torchgrasp.errors import check_range
from torchgrasp.planning.law import Course, Law, steps_after
from torchgrasp.sim.kinematics import Array


@dataclass(frozen=True)
class Funnel(Law):
    """The law's numbers; lengths in metres, angles in radians.

    Attributes:
        standoff: distance behind the grasp at which a misaligned hand waits (the planner's 8 cm).
        slope: standoff a metre of misalignment.
        lever: metres of misalignment that a radian counts for.
        tolerance: misalignment at which the way is free.
        arrive: share of the horizon after which the hand is at the grasp.
        align: share of the horizon after which the rotation is done.
        settle: steps that what is left is spread over once its time has come, so that late labels
            stay small and a late hand still arrives; the last step makes up for all that is left.
        retreat: metres a remaining step that the hand may still back off: late labels stay small.
        max_translation, max_rotation: of one step, so that actions stay inside their bounds.
    """

    standoff: float = 0.08
    slope: float = 2.0
    lever: float = 0.06
    tolerance: float = 0.004
    arrive: float = 0.85
    align: float = 0.65
    settle: float = 2.0
    retreat: float = 0.012
    max_translation: float = 0.055
    max_rotation: float = 0.45

    def __post_init__(self) -> None:
        for name in ("standoff", "slope", "lever", "tolerance", "retreat"):
            check_range(name, getattr(self, name), 0.0, np.inf)
        check_range("settle", self.settle, 1.0, np.inf)
        for name in ("arrive", "align"):
            check_range(name, getattr(self, name), 0.0, 1.0, open_low=True)

    def steer(self, T_base_ee: Array, courses: Sequence[Course], steps_left: Array, horizon: int) -> Array:
        """See `Law.steer`."""
        goals = np.array([course.T_base_goal for course in courses]).reshape(-1, 4, 4)
        return self.next_pose(T_base_ee, goals, steps_left, horizon)

    def next_pose(self, T_base_ee: Array, T_base_goal: Array, steps_left: Array, horizon: int) -> Array:
        """The hand pose one step on.

        Args:
            T_base_ee: (N, 4, 4) hand poses.
            T_base_goal: (N, 4, 4) grasps.
            steps_left: (N,) steps until the fingers close, at least 1.
            horizon: T, steps of the whole episode.

        Returns:
            (N, 4, 4) hand poses.
        """
        into_goal = T_base_goal[:, :3, :3].transpose(0, 2, 1)
        position = (into_goal @ (T_base_ee[:, :3, 3] - T_base_goal[:, :3, 3])[..., None])[..., 0]
        turn = Rotation.from_matrix(into_goal @ T_base_ee[:, :3, :3]).as_rotvec()
        angle = np.linalg.norm(turn, axis=-1)

        late = steps_left - 1
        least = np.minimum(self.settle, steps_left)
        steps = np.maximum(least, steps_left - steps_after(self.arrive, horizon))
        steps_turning = np.maximum(least, steps_left - steps_after(self.align, horizon))
        position = self._move(position, angle, steps, late)
        share = np.minimum(1.0 / steps_turning, self.max_rotation / np.maximum(angle, 1e-9))
        rotation = Rotation.from_rotvec(turn * (1 - share)[:, None]).as_matrix()

        out = np.tile(np.eye(4), (len(T_base_ee), 1, 1))
        out[:, :3, :3] = T_base_goal[:, :3, :3] @ rotation
        out[:, :3, 3] = T_base_goal[:, :3, 3] + (T_base_goal[:, :3, :3] @ position[..., None])[..., 0]
        return out

    def _move(self, position: Array, angle: Array, steps: Array, late: Array) -> Array:
        """(N, 3) position in the goal's frame one step on, at an even pace along the way left."""
        misaligned = np.linalg.norm(position[:, :2], axis=-1) + self.lever * angle - self.tolerance
        wait = np.clip(self.slope * misaligned, 0.0, np.minimum(self.standoff, self.retreat * late))
        gate = np.zeros_like(position)
        gate[:, 2] = -wait
        to_gate = gate - position
        distance = np.linalg.norm(to_gate, axis=-1)
        pace = np.minimum((distance + wait) / steps, self.max_translation)
        share = np.minimum(1.0, pace / np.maximum(distance, 1e-9))
        moved = position + share[:, None] * to_gate
        moved[:, 2] += np.minimum(np.maximum(pace - distance, 0.0), wait)
        return moved
