"""The whole scene as a compiled MuJoCo model, kept for the next episode of the same object."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.mujoco._mujoco import mujoco
from torchgrasp.sim.mujoco.panda_spec import FINGER_PRIORITY, LINK_PRIORITY, add_panda
from torchgrasp.sim.mujoco.target_spec import add_target, distribute
from torchgrasp.sim.panda_tables import BODY_FRICTION
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER

_KEPT = 1024  # models, of some 40 kB each


@dataclass(frozen=True)
class Contact:
    """How contacts are solved; see `MujocoEngine`, whose options these are in MuJoCo's terms."""

    condim: int
    torsion: float
    rolling: float
    solref: tuple[float, float]
    solimp: tuple[float, float, float, float, float]
    impratio: float
    noslip_iterations: int


@dataclass(frozen=True)
class SceneModel:
    """A compiled scene; nothing of it but the time step changes afterwards.

    Attributes:
        model: robot, table and target.
        T_object_principal: (4, 4) pose of the target's body in the object's frame.
    """

    model: Any
    T_object_principal: np.ndarray


_models: OrderedDict[tuple, SceneModel] = OrderedDict()


def compile_scene(target: GraspObject, physics: Physics, contact: Contact, *, held: bool) -> SceneModel:
    """The model of a scene with the target held where it is put, or free; compiled once for its numbers."""
    numbers = (physics.mass, physics.friction, physics.finger_friction, physics.finger_force)
    damping = (physics.linear_damping, physics.angular_damping)
    key = (target.content_hash, *numbers, *damping, contact, held)
    if key in _models:
        _models.move_to_end(key)
        return _models[key]
    scene = _models[key] = _compile(target, physics, contact, held)
    if len(_models) > _KEPT:
        _models.popitem(last=False)
    return scene


def _compile(target: GraspObject, physics: Physics, contact: Contact, held: bool) -> SceneModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.usethread = False  # what starts a thread cannot be copied by a fork
    option = spec.option
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio, option.noslip_iterations = contact.impratio, contact.noslip_iterations

    def touch(friction: float, priority: int) -> dict[str, Any]:
        slide = (friction, friction * contact.torsion, friction * contact.rolling)
        solved = {"solref": contact.solref, "solimp": contact.solimp, "condim": contact.condim}
        return {"friction": slide, "priority": priority, **solved}

    plain = touch(physics.friction, 0)
    half, middle = (TABLE_UPPER - TABLE_LOWER) / 2, (TABLE_LOWER + TABLE_UPPER) / 2
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=middle, **plain)
    # Two materials rub with the mean of their frictions, as in PhysX.
    add_panda(
        spec,
        link=touch((BODY_FRICTION + physics.friction) / 2, LINK_PRIORITY),
        finger=touch((physics.finger_friction + physics.friction) / 2, FINGER_PRIORITY),
        finger_force=physics.finger_force,
    )
    spread = distribute(target)
    add_target(spec, target, spread, mass=physics.mass, held=held, contact=plain)
    model: Any = spec.compile()
    if not held:
        linear, angular = physics.linear_damping, physics.angular_damping
        start = model.joint("target").dofadr[0]
        model.dof_damping[start : start + 3] = linear * physics.mass
        model.dof_damping[start + 3 : start + 6] = angular * model.body("target").inertia
    return SceneModel(model, spread.T_object_principal)
