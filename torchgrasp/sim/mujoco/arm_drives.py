"""The arm's drives with their limits of force, as PhysX has them."""

from __future__ import annotations

from typing import Any

import numpy as np

from torchgrasp.sim.kinematics import JOINT_EFFORT, JOINT_VELOCITY
from torchgrasp.sim.mujoco._mujoco import mujoco
from torchgrasp.sim.panda_tables import ARM_DAMPING, ARM_STIFFNESS

_ARM = slice(7)  # the arm's joints come first
_LEAD = ARM_DAMPING / ARM_STIFFNESS  # seconds by which a drive's rate puts its target ahead
_FASTEST = _LEAD * JOINT_VELOCITY  # rad that it is stretched by where the joint turns as fast as it may
_TRIALS = 8  # of which drives are at their limit; two are enough for most steps


class ArmDrives:
    """Springs and dampers towards a target that moves, each with a limit of its force.

    MuJoCo takes a damper into the step implicitly, but not where the force at the step's beginning is
    beyond a limit. A wrist of 0.01 kg m2 with 12 Nm would then overshoot at every step and tremble, and
    an arm that reverses would be far weaker than its limits. So the model's actuators have no limits, and
    it is the force at the step's end that counts, as in PhysX: a drive that would have more there is a
    constant force for this step. (One that comes to more within a step that begins below its limit keeps
    that, some hundredths of it.) What the speed will be follows from the arm's mass matrix and the forces
    on it, those of contacts taken from the step before. Nor does a drive ask for more speed than its
    joint may have: MuJoCo knows no limit of speeds.

    Args:
        q: (7,) where the arm stands.

    Attributes:
        q: (7,) targets, rad.
        rate: (7,) their rates, rad/s.
    """

    def __init__(self, q: np.ndarray) -> None:
        self.q, self.rate = np.asarray(q, np.float64), np.zeros(7)

    def prepare(self, model: Any, data: Any) -> None:
        """Write controls and dampers of the arm's actuators for the next step of a scene after its last."""
        q = data.qpos[_ARM]
        ahead = self.q + _LEAD * self.rate - q
        spring = ARM_STIFFNESS * np.minimum(np.maximum(ahead, -_FASTEST), _FASTEST)
        force = spring - ARM_DAMPING * data.qvel[_ARM]
        limit = np.zeros(7)
        if (np.abs(force) > JOINT_EFFORT).any():
            limit = _find_limits(model, data, force)
        data.ctrl[_ARM] = q + np.where(limit == 0.0, spring, limit) / ARM_STIFFNESS
        model.actuator_biasprm[_ARM, 2] = np.where(limit == 0.0, -ARM_DAMPING, 0.0)


def _find_limits(model: Any, data: Any, force: np.ndarray) -> np.ndarray:
    """(7,) forces, with their sign, of the drives that are at their limit after a step, and 0 of the others.

    Args:
        model: of the scene.
        data: of the scene, after its last step.
        force: (7,) that the drives would have before the step, Nm.
    """
    step = model.opt.timestep
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    others = (data.qfrc_passive - data.qfrc_bias + data.qfrc_constraint)[_ARM]
    limit = np.zeros(7)
    for _ in range(_TRIALS):
        is_free = limit == 0.0
        damping = np.diag(np.where(is_free, step * ARM_DAMPING, 0.0))
        total = np.where(is_free, force, limit) + others
        gained = np.linalg.solve(mass[_ARM, _ARM] + damping, step * total)  # of speed, rad/s
        after = force - ARM_DAMPING * gained
        found = np.where(np.abs(after) > JOINT_EFFORT, np.copysign(JOINT_EFFORT, after), 0.0)
        if (found == limit).all():
            break
        limit = found
    return limit
