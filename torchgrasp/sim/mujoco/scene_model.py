"""The whole scene as a compiled MuJoCo model, kept for the next episode of the same object."""

from __future__ import annotations

from collections import OrderedDict
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.mujoco._mujoco import mujoco
from torchgrasp.sim.mujoco.panda_spec import FINGER_PRIORITY, LINK_PRIORITY, add_panda
from torchgrasp.sim.mujoco.scene_physics import set_physics
from torchgrasp.sim.mujoco.target_spec import Distribution, add_target, distribute
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER

_MOST_KEPT = 1024  # models, of 30 to 120 kB each


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
class Scene:
    """A scene of one world alone.

    Attributes:
        model: robot, table and target.
        data: its state, as MuJoCo begins.
        T_object_principal: (4, 4) pose of the target's body in the object's frame.
    """

    model: Any
    data: Any
    T_object_principal: np.ndarray


# Models that are copied, never changed, and how the mass of their target lies.
_kept: OrderedDict[tuple, tuple[Any, Distribution]] = OrderedDict()


def make_scene(target: GraspObject, physics: Physics, contact: Contact, *, held: bool) -> Scene:
    """A scene with the target held where it is put, or free; compiled once for an object.

    Each has a copy of the model, in which the numbers of `physics` are written: what the solver reads at
    every step is then its world's own, and a time step that one world sets is no other's.
    """
    key = (target.content_hash, contact, held)
    if key not in _kept:
        spread = distribute(target)
        _kept[key] = (make_spec(target, contact, spread, held=held).compile(), spread)
        if len(_kept) > _MOST_KEPT:
            _kept.popitem(last=False)
    _kept.move_to_end(key)
    compiled, spread = _kept[key]
    model = copy(compiled)
    data = mujoco.MjData(model)
    options = {"torsion": contact.torsion, "rolling": contact.rolling}
    set_physics(model, data, physics, moments=spread.moments, **options)
    return Scene(model, data, spread.T_object_principal)


def make_spec(target: GraspObject, contact: Contact, spread: Distribution, *, held: bool) -> Any:
    """What is compiled: all of a scene but the numbers of its physics."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.usethread = False  # what starts a thread cannot be copied by a fork
    option = spec.option
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio, option.noslip_iterations = contact.impratio, contact.noslip_iterations
    plain = {"solref": contact.solref, "solimp": contact.solimp, "condim": contact.condim}
    half, middle = (TABLE_UPPER - TABLE_LOWER) / 2, (TABLE_LOWER + TABLE_UPPER) / 2
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=middle, **plain)
    add_panda(spec, link={**plain, "priority": LINK_PRIORITY}, finger={**plain, "priority": FINGER_PRIORITY})
    add_target(spec, target, spread, held=held, contact=plain)
    return spec
