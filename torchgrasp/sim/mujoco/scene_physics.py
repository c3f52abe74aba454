"""The numbers of `Physics` in a compiled scene: masses, frictions, damping and the fingers' force."""

from __future__ import annotations

from typing import Any

import numpy as np

from torchgrasp.sim.mujoco._mujoco import mujoco
from torchgrasp.sim.mujoco.panda_spec import FINGER_PRIORITY, FINGERS, LINK_PRIORITY
from torchgrasp.sim.panda_tables import BODY_FRICTION, FINGER_OPEN, FINGER_STIFFNESS, FINGER_VELOCITY
from torchgrasp.sim.physics import Physics


def set_physics(
    model: Any, data: Any, physics: Physics, *, moments: np.ndarray, torsion: float, rolling: float
) -> None:
    """Write what may differ from episode to episode, so that the model is as if compiled for it.

    Args:
        model: a compiled scene.
        data: of the model; its state is lost.
        physics: of the episode.
        moments: (3,) m2, the target's principal moments for a mass of 1 kg.
        torsion: metres by which friction becomes resistance to turning.
        rolling: metres by which it becomes resistance to rolling.
    """
    _set_target(model, physics, moments)
    # Two materials rub with the mean of their frictions, as in PhysX.
    frictions = np.full(model.ngeom, physics.friction)
    frictions[model.geom_priority == LINK_PRIORITY] = (BODY_FRICTION + physics.friction) / 2
    frictions[model.geom_priority == FINGER_PRIORITY] = (physics.finger_friction + physics.friction) / 2
    model.geom_friction[:] = np.outer(frictions, (1.0, torsion, rolling))
    force = physics.finger_force
    for name in FINGERS:
        model.actuator_forcerange[model.actuator(name).id] = (-force, force)
        # A drive of this force, or of what its spring has at most, cannot move the finger faster than it may:
        # MuJoCo knows no limit of speeds.
        most = min(force, 2 * FINGER_STIFFNESS * FINGER_OPEN)
        model.dof_damping[model.joint(name).dofadr] = most / FINGER_VELOCITY
    mujoco.mj_setConst(model, data)
    # The compiler's means, which mj_setConst leaves as they are. The solver ends by the first. It adds one
    # number after the other, as cumsum does; sum() rounds otherwise from Python 3.12 on.
    model.stat.meaninertia = np.cumsum(model.dof_M0)[-1] / model.nv
    model.stat.meanmass = np.cumsum(model.body_mass[1:])[-1] / (model.nbody - 1)
    mujoco.mj_resetData(model, data)


def _set_target(model: Any, physics: Physics, moments: np.ndarray) -> None:
    body = model.body("target").id
    inertia = physics.mass * moments
    model.body_mass[body], model.body_inertia[body] = physics.mass, inertia
    if model.body_dofnum[body]:  # it is free
        start = int(model.body_dofadr[body])
        model.dof_damping[start : start + 3] = physics.linear_damping * physics.mass
        model.dof_damping[start + 3 : start + 6] = physics.angular_damping * inertia
