"""Files as users bring them, written from nothing: a folder of meshes, and the same in ACRONYM's layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import trimesh

from torchgrasp.geometry import invert_pose
from torchgrasp.objects import FolderObjects
from torchgrasp.objects.acronym import T_ACRONYM_EE, import_h5py

# (radius, z) in metres of half a section.
_SPOOL = ((0, -45), (32, -45), (32, -36), (13, -28), (13, 28), (32, 36), (32, 45), (0, 45))


def write_meshes(folder: Path) -> None:
    """A prism, a ring and a spool in metres, each in another format."""
    folder.mkdir(parents=True)
    trimesh.creation.cylinder(0.025, 0.1, sections=6).export(folder / "prism.ply")
    trimesh.creation.annulus(0.02, 0.032, 0.04).export(folder / "ring.stl")
    trimesh.creation.revolve(np.array(_SPOOL) / 1000).export(folder / "spool.obj")


def write_acronym(folder: Path, objects: FolderObjects) -> None:
    """The objects in ACRONYM's layout, their own grasps as those that held in its simulator."""
    h5py, T_ee_acronym = import_h5py(), invert_pose(torch.from_numpy(T_ACRONYM_EE)).numpy()
    (folder / "grasps").mkdir(parents=True)
    for item in objects:
        mesh = Path("meshes", item.name.capitalize(), f"{item.name}.obj")
        (folder / mesh).parent.mkdir(parents=True)
        trimesh.Trimesh(item.vertices, item.faces).export(folder / mesh)
        with h5py.File(folder / "grasps" / f"{mesh.parent.name}_{item.name}_1.0.h5", "w") as file:
            file["object/file"], file["object/scale"] = str(mesh), 1.0
            file["grasps/transforms"] = item.grasps @ T_ee_acronym
            file["grasps/qualities/flex/object_in_gripper"] = np.ones(len(item.grasps))
