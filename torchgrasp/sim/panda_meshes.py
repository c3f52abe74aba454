"""The Panda's own meshes, where a package has them: pybullet's, which the extra `random-urdfs` installs.

They are franka_ros's (Franka Robotics GmbH, formerly Franka Emika; Apache License 2.0), converted for
PyBullet. They are read as data; the package is not imported.
"""

from __future__ import annotations

import functools
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.names import one_line
from torchgrasp.objects.mesh_files import read_bytes
from torchgrasp.objects.packaged import package_folder
from torchgrasp.sim import kinematics
from torchgrasp.sim.panda_tables import FINGER_MOUNT
from torchgrasp.sim.scene_parts import Part
from torchgrasp.sim.visuals import mesh_visual

Colour = tuple[float, float, float]

# What panda.urdf shows of links 0 to 7, hand, left and right finger; links 0 and 7 have no finer mesh.
FILES = (
    "collision/link0.obj",
    *(f"visual/link{i}.obj" for i in range(1, 7)),
    "collision/link7.obj",
    "visual/hand.obj",
    "visual/finger.obj",
    "visual/finger.obj",
)
_WHITE = (1.0, 1.0, 1.0)
# No link reaches farther from its origin, metres; one in another unit does.
_REACH = 0.35
_REMEDY = "install pybullet again."


@dataclass(frozen=True, eq=False)
class PandaMeshes:
    """The robot in P parts, each of one colour.

    Attributes:
        parts: in the frames of their links.
        links: (P,) the link that each is fixed to: 0 to 7, then hand, left finger, right finger.
    """

    parts: tuple[Part, ...]
    links: NDArray

    def poses(self, joints: NDArray, T_base_ee: NDArray) -> NDArray:
        """(9,) joints and the hand's (4, 4) pose to the (P, 4, 4) poses of the parts, base frame."""
        return link_frames(joints, T_base_ee)[self.links]


def meshes_folder() -> Path | None:
    """The folder that an installed pybullet keeps the meshes in; None without the package."""
    try:
        return package_folder("pybullet_data", "random-urdfs") / "franka_panda" / "meshes"
    except ConfigError:
        return None


def read_meshes(folder: Path) -> PandaMeshes:
    """The meshes in a folder laid out like pybullet's; ObjectError says what is wrong with a file."""
    read = functools.cache(lambda name: _read_parts(folder / name))
    found = [(link, part) for link, name in enumerate(FILES) for part in read(name)]
    return PandaMeshes(tuple(part for _, part in found), np.array([link for link, _ in found]))


def link_frames(joints: NDArray, T_base_ee: NDArray) -> NDArray:
    """(9,) joints and the (4, 4) hand pose to the (11, 4, 4) poses of links, hand and fingers, base frame."""
    frames = np.tile(np.eye(4), (11, 1, 1))
    frames[1:8] = kinematics.link_poses(joints[None, :7])[0, :7]
    frames[9:, 2, 3] = FINGER_MOUNT
    frames[9, 1, 3], frames[10, 1, 3] = joints[7], -joints[8]
    frames[10, (0, 1), (0, 1)] = -1.0  # the right finger is the left one, turned about z
    frames[8:] = T_base_ee @ frames[8:]
    return frames


def _read_parts(path: Path) -> list[Part]:
    """An obj file as one part for each of its colours, link frame."""
    # Colours lie beside what is for the eye alone; their texture, which holds baked shadows, is left aside.
    materials = path.with_suffix(".mtl") if path.parent.name == "visual" else None
    beside = {materials.name: read_bytes(materials)} if materials else {}
    data = read_bytes(path)
    if not data.endswith(b"\n"):
        raise ObjectError(f"{path} is cut off: {_REMEDY}")
    options: Any = {"resolver": beside, "process": False}
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type="obj", **options)
        meshes: list[Any] = list(scene.geometry.values())
        colours = [_colour(mesh) if materials else _WHITE for mesh in meshes]
        surfaces = [(colour, _triangles(mesh)) for colour, mesh in zip(colours, meshes, strict=True)]
    except Exception as error:  # trimesh's reader raises whatever the damage makes it meet
        raise ObjectError(
            one_line(f"{path} is damaged ({type(error).__name__}: {error}): {_REMEDY}")
        ) from error
    if not surfaces or not all(np.abs(triangles).max() < _REACH for _, triangles in surfaces):
        raise ObjectError(f"{path} is damaged, it holds no link in metres: {_REMEDY}")
    return [
        _part(colour, np.concatenate([triangles for each, triangles in surfaces if each == colour]))
        for colour in dict.fromkeys(colours)
    ]


def _colour(mesh: trimesh.Trimesh) -> Colour:
    """The diffuse colour of a mesh's material."""
    visual: Any = mesh.visual
    red, green, blue = (visual.material.diffuse[:3] / 255.0).tolist()
    return red, green, blue


def _triangles(mesh: trimesh.Trimesh) -> NDArray:
    """(F, 3, 3) corners of a mesh's triangles."""
    return np.asarray(mesh.vertices)[np.asarray(mesh.faces)]


def _part(colour: Colour, triangles: NDArray) -> Part:
    corners = triangles.reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    # The links are closed: nobody looks in.
    visual = mesh_visual(corners, faces, repeats=0.0, both_sides=False)
    return Part(visual, colour, roughness=0.5, specular=0.4)
