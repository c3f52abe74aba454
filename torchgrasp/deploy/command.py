"""What an arm is to do next, as GraspAgent says it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class GraspCommand:
    """The next step of one arm, or of N arms with a first dimension N.

    Attributes:
        T_base_ee: (*, 4, 4) pose that the hand is to reach in one control period, base frame, metres.
        action: (*, 6) the same as the policy says it: relative to the hand, metres and intrinsic XYZ Euler
            angles. `T_base_ee` may lie higher, where the hand would meet the table.
        close: (*) bool, whether the fingers close when that pose is reached.
        goal: (*, 4, 4) the grasp that the policy has in mind, base frame; NaN where it tells none.
        num_points: (*) how many points of the target the policy was shown; 1, a guess, once all have gone.
        age: (*) seconds since the target was last seen.
        problems: what kept the policy from acting, for each arm; None where it acts. With a problem the hand
            stays, or goes back to where it last saw the target.
    """

    T_base_ee: np.ndarray
    action: np.ndarray
    close: np.ndarray
    goal: np.ndarray
    num_points: np.ndarray
    age: np.ndarray
    problems: tuple[str | None, ...]

    @property
    def problem(self) -> str | None:
        """The first of the problems; None where every arm acts."""
        return next((each for each in self.problems if each is not None), None)
