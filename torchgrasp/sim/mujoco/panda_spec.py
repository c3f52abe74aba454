"""The Panda in a MuJoCo specification, of the same tables as PhysX's."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from torchgrasp.sim import kinematics
from torchgrasp.sim.mujoco._mujoco import mujoco
from torchgrasp.sim.panda_tables import (
    ARM_DAMPING,
    ARM_SHAPES,
    ARM_STIFFNESS,
    FINGER_ARMATURE,
    FINGER_INERTIAL,
    FINGER_MOUNT,
    FINGER_OPEN,
    FINGER_SHAPES,
    FINGER_STIFFNESS,
    HAND_INERTIAL,
    HAND_SHAPES,
    IGNORE_BITS,
    INERTIALS,
    Inertial,
    Shape,
    mirrored,
)

# A joint's stop gives way by tenths of a millimetre or 2 mrad under a drive's whole force.
_STOP = {"limited": True, "solref_limit": (0.005, 1.0), "solimp_limit": (0.99, 0.999, 1e-3, 0.5, 2.0)}
# Of geoms: the higher one's friction and contact hold.
LINK_PRIORITY, FINGER_PRIORITY = 1, 2
# Bodies, and of fingers their joints and actuators.
LINKS, FINGERS = (*(f"link{i}" for i in range(8)), "hand"), ("left_finger", "right_finger")


def add_panda(spec: Any, *, link: dict[str, Any], finger: dict[str, Any]) -> None:
    """Add the arm and the hand with their drives, joints and actuators in the order of `joints`.

    The fingers' force, and the damping that goes with it, is set in the compiled model: see `set_physics`.

    Args:
        spec: to add to.
        link: properties of the contacts of all links but the fingers, by name.
        finger: the same of the fingers.
    """
    body = _add_link(spec.worldbody, "link0", INERTIALS[0], ARM_SHAPES[0], link)
    limits = zip(kinematics.JOINT_LOWER, kinematics.JOINT_UPPER, strict=True)
    for i, ((xyz, roll), (low, high)) in enumerate(
        zip(kinematics.JOINT_ORIGINS, limits, strict=True), start=1
    ):
        body = _add_link(body, f"link{i}", INERTIALS[i], ARM_SHAPES[i], link, pos=xyz, quat=_roll(roll))
        body.add_joint(
            name=f"joint{i}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=(0, 0, 1),
            range=(low, high),
            **_STOP,
        )
        _add_drive(spec, f"joint{i}", ARM_STIFFNESS, ARM_DAMPING)
    half = kinematics.HAND_YAW / 2
    turned = (np.cos(half), 0, 0, np.sin(half))
    flange = (0, 0, kinematics.FLANGE_LENGTH)
    hand = _add_link(body, "hand", HAND_INERTIAL, HAND_SHAPES, link, pos=flange, quat=turned)
    for side, name in zip((1.0, -1.0), FINGERS, strict=True):
        shapes = FINGER_SHAPES if side > 0 else tuple(mirrored(shape) for shape in FINGER_SHAPES)
        body = _add_link(hand, name, FINGER_INERTIAL, shapes, finger, pos=(0, 0, FINGER_MOUNT))
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=(0, side, 0),
            range=(0.0, FINGER_OPEN),
            armature=FINGER_ARMATURE,
            **_STOP,
        )
        _add_drive(spec, name, FINGER_STIFFNESS, 0.0, limited=True)
    for one, other in combinations((*LINKS, *FINGERS), 2):
        if _bits(one) & _bits(other):
            spec.add_exclude(bodyname1=one, bodyname2=other)


def _bits(name: str) -> int:
    return IGNORE_BITS["finger" if name in FINGERS else name]


def _roll(angle: float) -> tuple[float, ...]:
    """Quaternion wxyz of a turn about x."""
    return (float(np.cos(angle / 2)), float(np.sin(angle / 2)), 0.0, 0.0)


def _add_link(
    parent: Any,
    name: str,
    inertial: Inertial,
    shapes: tuple[Shape, ...],
    contact: dict[str, Any],
    **place: Any,
) -> Any:
    """A body without gravity, with its mass and its shapes."""
    body = parent.add_body(
        name=name,
        mass=inertial.mass,
        ipos=inertial.centre,
        fullinertia=(*inertial.diagonal, *inertial.products),
        explicitinertial=True,
        gravcomp=1.0,
        **place,
    )
    for shape in shapes:
        is_box = len(shape.size) == 3
        half = [length / 2 for length in shape.size]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX if is_box else mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=half if is_box else (shape.size[0], half[1], 0.0),
            pos=shape.position,
            quat=_roll(shape.roll),
            **contact,
        )
    return body


def _add_drive(spec: Any, joint: str, stiffness: float, damping: float, *, limited: bool = False) -> None:
    """A spring towards the control and a damper, whose force may be limited."""
    spec.add_actuator(
        name=joint,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        gainprm=[stiffness, *[0.0] * 9],
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        biasprm=[0.0, -stiffness, -damping, *[0.0] * 7],
        forcelimited=limited,
        forcerange=(-float(limited), float(limited)),
    )
