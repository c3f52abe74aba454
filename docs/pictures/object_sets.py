"""The contact sheets of object sets, a row each, and of the families of household shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from contact_sheet import sheet
from example_meshes import write_acronym, write_meshes

from torchgrasp.objects import (
    AcronymObjects,
    FolderObjects,
    MixtureObjects,
    ProceduralObjects,
    RandomUrdfObjects,
    YcbObjects,
)
from torchgrasp.objects.household import HOUSEHOLD
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import CameraIntrinsics, Physics, RenderCamera, View, look_at, settled_poses
from torchgrasp.sim.kinematics import READY_POSTURE, forward_kinematics

_CLOSE = RenderCamera(
    CameraIntrinsics(240, 180, fov=0.6, near=0.05, far=3.0),
    T_base_camera=look_at((0.83, -0.24, 0.30), (0.5, 0.0, 0.05)),
)
# The arm turned aside, so that it hides nothing.
_ASIDE = READY_POSTURE + np.array([1.6, 0, 0, 0, 0, 0, 0])


def picture_objects(folder: Path, meshes: Path) -> None:
    """Five objects of each set and one of each household family, at rest on the table."""
    write_meshes(meshes / "folder")
    folder_objects = FolderObjects(meshes / "folder")
    write_acronym(meshes / "acronym", folder_objects)
    ycb, random_urdfs = YcbObjects("test"), RandomUrdfObjects("test")
    procedural = ProceduralObjects("test", num_objects=10)
    household = ProceduralObjects("test", families=[*HOUSEHOLD], num_objects=len(HOUSEHOLD))
    mixture = MixtureObjects({"procedural": procedural, "ycb": ycb})
    draws = np.random.default_rng(1)
    rows = {
        "procedural": [procedural[i] for i in (3, 4, 5, 7, 8)],
        "ycb": [ycb[i] for i in (1, 3, 5, 6, 7)],
        "random_urdfs": [random_urdfs[i] for i in (0, 2, 3, 4, 7)],
        "mixture": [mixture[mixture.draw(draws)] for _ in range(5)],
        "folder": [*folder_objects],
        "acronym": [*AcronymObjects(meshes / "acronym")][1:],
    }
    tiles = [(each.name.removesuffix("-00000"), _at_rest(each)) for row in rows.values() for each in row]
    sheet(folder / "objects.jpg", tiles, columns=5)
    tiles = [(each.family, _at_rest(each)) for each in household]
    sheet(folder / "household.jpg", tiles, columns=5)


def _at_rest(target: GraspObject) -> np.ndarray:
    T_base_object = settled_poses(target, Physics())[0].copy()
    T_base_object[:2, 3] = 0.5, 0.0
    joints = np.array([*_ASIDE, 0.04, 0.04])
    return _CLOSE.observe(View(target, T_base_object, joints, forward_kinematics(_ASIDE[None])[0]))["rgb"]
