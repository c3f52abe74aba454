"""The postures that a controller of hand poses drives the arm through."""

from __future__ import annotations

import numpy as np

from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.tracking import track_pose

# Metres and radians that the hand may be off a pose that is due; the next step corrects it.
_MISS = 2e-3


def drive_along(q: Array, T_base_ee: Array) -> Array | None:
    """Inverse kinematics along a way of the hand, as the controller continues it from step to step.

    Args:
        q: (7,) posture at the way's first pose.
        T_base_ee: (S + 1, 4, 4) hand poses a control step apart.

    Returns:
        (S + 1, 7) postures, None where joint limits or reach keep the arm from following.
    """
    postures = np.empty((len(T_base_ee), 7))
    postures[0] = q
    for step in range(1, len(T_base_ee)):
        postures[[step]], error = track_pose(postures[[step - 1]], T_base_ee[[step]], tolerance=1e-4)
        if error[0] > _MISS:
            return None
    return postures
