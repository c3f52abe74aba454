"""The scene of a rehearsal as MuJoCo's XML: a table and one object beside franky-sim's arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh

from torchgrasp.errors import ConfigError
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.mujoco.target_spec import distribute
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER

OBJECT, OBJECT_JOINT = "target", "target_joint"
_FINGERS = ("robot0_left_finger", "robot0_right_finger")
_FLOOR = -0.4  # metres; the table's legs are not drawn


@dataclass(frozen=True)
class Contact:
    """How bodies of a rehearsal touch. Friction itself is that of `Physics`.

    MuJoCo takes the larger friction of two bodies, so that fingers hold with theirs and the object slides on
    the table with its own.

    Attributes:
        impratio: stiffness of friction beside that of the normal force, of elliptic cones. At MuJoCo's 1 a
            held object creeps out of the fingers.
        torsion: metres; moment about a contact's normal, as a share of its force. Rounded pads have some,
            as SAPIEN's patches have.
        solref: seconds and damping ratio of a contact; MuJoCo's 0.02 lets a finger sink in by millimetres.
        solimp: impedance of a contact, as in MuJoCo's manual.
    """

    impratio: float = 10.0
    torsion: float = 0.02
    solref: tuple[float, float] = (0.005, 1.0)
    solimp: tuple[float, float, float] = (0.95, 0.99, 0.001)


def build_scene(
    simulator: Any, target: GraspObject, T_base_object: np.ndarray, physics: Physics, contact: Contact
) -> None:
    """Put table and object into a MujocoSimulator that has its arm and has not started.

    Args:
        simulator: of franky_sim.
        target: the object, as its convex parts.
        T_base_object: (4, 4) its pose.
        physics: mass and frictions.
        contact: how bodies touch.

    Raises:
        ConfigError: where franky-sim's scene is another one than this was written for.
    """
    option = _one(simulator.scene, "option")
    option.set("cone", "elliptic")
    option.set("impratio", str(contact.impratio))
    floor = _one(simulator.worldbody, "geom[@name='ground']")
    floor.set("pos", _text((0.0, 0.0, _FLOOR)))
    touch = {"condim": "4", "solref": _text(contact.solref), "solimp": _text(contact.solimp)}
    surface = {**touch, "friction": _text((physics.friction, contact.torsion, 1e-4))}
    table = {"name": "table", "type": "box", "rgba": "0.72 0.62 0.5 1"}
    table |= {"pos": _text((TABLE_LOWER + TABLE_UPPER) / 2), "size": _text((TABLE_UPPER - TABLE_LOWER) / 2)}
    ElementTree.SubElement(simulator.worldbody, "geom", table | surface)
    pads = {**touch, "friction": _text((physics.finger_friction, contact.torsion, 1e-4))}
    for name in _FINGERS:
        for geom in _one(simulator.worldbody, f".//body[@name='{name}']").findall("geom"):
            if geom.get("class") != "visual":
                geom.attrib.update(pads)
    _add_object(simulator, target, T_base_object, physics, surface)


def _add_object(
    simulator: Any, target: GraspObject, T_base_object: np.ndarray, physics: Physics, surface: dict[str, str]
) -> None:
    """The object as a free body of convex meshes, with the mass that all objects share."""
    turn = trimesh.transformations.quaternion_from_matrix(T_base_object)
    pose = {"pos": _text(T_base_object[:3, 3]), "quat": _text(turn)}  # wxyz
    body = ElementTree.SubElement(simulator.worldbody, "body", {"name": OBJECT, **pose})
    ElementTree.SubElement(body, "joint", {"name": OBJECT_JOINT, "type": "free"})
    spin = object_inertia(target, physics.mass)
    full = _text((*np.diag(spin), spin[0, 1], spin[0, 2], spin[1, 2]))
    ElementTree.SubElement(body, "inertial", {"pos": "0 0 0", "mass": str(physics.mass), "fullinertia": full})
    assets = _one(simulator.scene, "asset")
    for number, part in enumerate(target.parts):
        name = f"{OBJECT}_{number}"
        ElementTree.SubElement(
            assets, "mesh", {"name": name, "vertex": _text(part.ravel()), "inertia": "shell"}
        )
        shape = {"type": "mesh", "mesh": name, "rgba": "0.93 0.5 0.13 1", "density": "0"}
        ElementTree.SubElement(body, "geom", shape | surface)


def object_inertia(target: GraspObject, mass: float) -> np.ndarray:
    """(3, 3) inertia about the object's origin, kg m2, of its parts at one density."""
    spread = distribute(target)
    axes, centre = spread.T_object_principal[:3, :3], spread.T_object_principal[:3, 3]
    about_centre = (axes * spread.moments) @ axes.T
    return mass * (about_centre + centre @ centre * np.eye(3) - np.outer(centre, centre))


def damp_object(model: Any, target: GraspObject, physics: Physics) -> None:
    """Give a compiled scene's object the damping of `Physics`, which XML cannot tell of a free joint."""
    first = int(model.joint(OBJECT_JOINT).dofadr[0])
    model.dof_damping[first : first + 3] = physics.linear_damping * physics.mass
    spin = np.diag(object_inertia(target, physics.mass))
    model.dof_damping[first + 3 : first + 6] = physics.angular_damping * spin


def _one(parent: Any, path: str) -> Any:
    found = parent.find(path)
    if found is None:
        raise ConfigError(
            f"franky-sim's scene has no {path}, which a rehearsal changes: install the version of "
            'constraints.txt, pip install -c constraints.txt "torchgrasp[dev]".'
        )
    return found


def _text(numbers: Any) -> str:
    return " ".join(repr(float(each)) for each in numbers)
