"""A small data set in ACRONYM's layout and format, made from a box."""

from pathlib import Path

import h5py
import numpy as np
import trimesh

SIZE = np.array((0.04, 0.05, 0.06))  # metres
CENTRE = np.array((0.3, -0.1, 0.2))  # of the box in the scaled mesh: ShapeNet's frames lie anywhere
SCALE = 0.0025  # metres a unit of the mesh


def acronym_pose(approach: np.ndarray, closing: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """A hand whose fingers open along x, pads 10.34 cm ahead along z at `tip`."""
    pose = np.eye(4)
    pose[:3, :3] = np.stack((closing, np.cross(approach, closing), approach), axis=1)
    pose[:3, 3] = tip - 0.1034 * approach
    return pose


def write_acronym(folder: Path, *, num_grasps: int = 120) -> str:
    """The name of a box of SIZE with successful grasps across its x, and as many failed ones beside it."""
    mesh = trimesh.creation.box(SIZE / SCALE)
    mesh.apply_translation(CENTRE / SCALE)
    (folder / "meshes" / "Crate").mkdir(parents=True, exist_ok=True)
    (folder / "grasps").mkdir(exist_ok=True)
    mesh.export(folder / "meshes" / "Crate" / "abc.obj")
    rng, x = np.random.default_rng(0), np.array((1.0, 0.0, 0.0))
    poses = []
    for angle in rng.uniform(-np.pi, np.pi, num_grasps):
        approach = np.array((0.0, np.cos(angle), np.sin(angle)))
        poses.append(acronym_pose(approach, x, CENTRE + rng.uniform(-0.003, 0.003, 3)))
    far = np.array(poses)
    far[:, :3, 3] += 0.3
    name = f"Crate_abc_{SCALE}"
    with h5py.File(folder / "grasps" / f"{name}.h5", "w") as file:
        file["grasps/transforms"] = np.concatenate((poses, far))
        file["grasps/qualities/flex/object_in_gripper"] = np.repeat((1, 0), num_grasps)
        file["object/file"] = "meshes/Crate/abc.obj"
        file["object/scale"] = SCALE
    return name
