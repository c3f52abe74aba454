"""The arm's drives with their limits of force, as PhysX has them."""

from __future__ import annotations

import numpy as np

from torchgrasp.sim.kinematics import JOINT_EFFORT, JOINT_VELOCITY
from torchgrasp.sim.panda_tables import ARM_DAMPING, ARM_STIFFNESS

_LEAD = ARM_DAMPING / ARM_STIFFNESS  # seconds by which a drive's rate puts its target ahead
_REACH = JOINT_EFFORT / ARM_STIFFNESS  # rad that a spring is stretched by the largest force
_FASTEST = _LEAD * JOINT_VELOCITY  # rad that it is stretched by where the joint turns as fast as it may


class ArmDrives:
    """Springs and dampers towards a target that moves, each with a limit of its force.

    MuJoCo takes a damper into the step implicitly, but not where it has cut the force off at a limit: a wrist
    of 0.01 kg m2 with 12 Nm would then overshoot at every step and tremble. So the model's actuators have no
    limits. A drive that asks for more than its limit after a step, as where the arm is blocked, is given a
    nearer target in the next one, with which it asks for that much. Nor does a drive ask for more speed than
    its joint may have: MuJoCo knows no limit of speeds.

    Args:
        q: (7,) where the arm stands.

    Attributes:
        q: (7,) targets, rad.
        rate: (7,) their rates, rad/s.
    """

    def __init__(self, q: np.ndarray) -> None:
        self.q, self.rate = np.asarray(q, np.float64), np.zeros(7)
        self._last = self.q

    def control(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(7,) controls of the actuators for the next step, the arm being at (q, v)."""
        ahead = self.q + _LEAD * self.rate - q
        wanted = q + np.minimum(np.maximum(ahead, -_FASTEST), _FASTEST)
        moved = q + _LEAD * v
        too_much = np.abs(self._last - moved) > _REACH
        self._last = wanted
        if not too_much.any():
            return wanted
        nearer = moved + np.minimum(np.maximum(wanted - moved, -_REACH), _REACH)
        return np.where(too_much, nearer, wanted)
