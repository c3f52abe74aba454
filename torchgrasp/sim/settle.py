"""Resting poses proved by physics: computed once an object and kept on disk, so that no reset waits."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from torchgrasp.errors import ObjectError
from torchgrasp.names import file_stem, to_path
from torchgrasp.objects.cache import cache_key, cached, default_cache_dir, write_whole
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.parallel import run_each
from torchgrasp.objects.sets import ObjectSet
from torchgrasp.sim._sapien import sapien
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.sapien_world import build_target
from torchgrasp.sim.table import build_table

_VERSION = 1  # part of every file's name: raise it when the same object gives other poses
_SETTLE_RATE = 120
_MAX_SECONDS = 10
_MAX_DRIFT = 1e-3
_MAX_TURN = 0.02
_DROP_HEIGHT = 5e-4
_SAME_TILT = 0.05
# Where the objects are dropped, clear of the table's rim.
_PLACE = np.array([0.6, 0.0, 0.0])


def settle(target: GraspObject, physics: Physics) -> np.ndarray:
    """Drop the object in each of its candidate poses and keep those in which it then lies still.

    Args:
        target: the object; its `resting_poses` are the candidates.
        physics: friction, mass and damping.

    Returns:
        (K, 4, 4) float64 poses on z = 0 with the object's origin above (0, 0), most probable first;
        two that differ only by a turn about z count as one.
    """
    settled: list[np.ndarray] = []
    for candidate in target.resting_poses.astype(np.float64):
        pose = _drop(target, candidate, physics)
        if pose is not None and not any(_same_rest(pose, other) for other in settled):
            settled.append(pose)
    return np.array(settled).reshape(-1, 4, 4)


def settled_poses(
    target: GraspObject, physics: Physics, *, cache_dir: str | Path | None = None
) -> np.ndarray:
    """What `settle` returns, computed once for an object and the physics that matter to its rest.

    Args:
        target: the object.
        physics: friction, mass and damping; the rest of it is of no account here.
        cache_dir: where poses are kept, ``resting`` beside the objects' default cache.
    """
    path = _path(target, physics, cache_dir)
    return cached(path, lambda: settle(target, physics), load=_load, save=_save)


def prepare_resting(
    objects: ObjectSet,
    physics: Physics,
    *,
    workers: int | None = None,
    progress: bool = True,
    cache_dir: str | Path | None = None,
) -> None:
    """Build the objects that the cache lacks and prove their resting poses, with a line of progress.

    Objects that cannot be used are passed over: the cache remembers why.

    Args:
        objects: the set.
        physics: in which poses are proved.
        workers: processes; None for one a core.
        progress: show the line.
        cache_dir: see `settled_poses`.
    """
    work = partial(_prepare_one, objects, physics, cache_dir)
    unbuilt = set(objects.missing())
    missing = [
        i for i in range(len(objects)) if i in unbuilt or not _is_settled(objects, physics, cache_dir, i)
    ]
    named = objects.names.__getitem__
    run_each(work, missing, workers=workers, label="preparing objects", name=named, progress=progress)


def _is_settled(objects: ObjectSet, physics: Physics, cache_dir: str | Path | None, index: int) -> bool:
    return objects.refusal(index) is not None or _path(objects[index], physics, cache_dir).exists()


def _prepare_one(objects: ObjectSet, physics: Physics, cache_dir: str | Path | None, index: int) -> None:
    try:
        settled_poses(objects[index], physics, cache_dir=cache_dir)
    except ObjectError:
        return


def _path(target: GraspObject, physics: Physics, cache_dir: str | Path | None) -> Path:
    folder = default_cache_dir().parent / "resting" if cache_dir is None else to_path("cache_dir", cache_dir)
    values = (physics.mass, physics.friction, physics.linear_damping, physics.angular_damping)
    key = cache_key("settled", _VERSION, target.content_hash, tuple(map(float, values)))
    return folder / f"{file_stem(target.name)}-{key}.npy"


def _load(path: Path) -> np.ndarray:
    # Mapped first, which compares the file's size with the shape that it tells.
    poses = np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    if poses.shape[1:] != (4, 4):
        raise ValueError(f"shape {poses.shape}")
    return poses


def _save(path: Path, poses: np.ndarray) -> None:
    write_whole(path, lambda file: np.save(file, poses, allow_pickle=False))


def _drop(target: GraspObject, candidate: np.ndarray, physics: Physics) -> np.ndarray | None:
    """(4, 4) pose in which the object stays for a second, None where it never does."""
    system = sapien.physx.PhysxCpuSystem()
    system.timestep = 1.0 / _SETTLE_RATE
    scene = sapien.Scene([system])
    material = sapien.physx.PhysxMaterial(physics.friction, physics.friction, 0.0)
    build_table(scene, material)
    pose = candidate.copy()
    pose[:3, 3] += _PLACE
    pose[2, 3] += _DROP_HEIGHT
    body = build_target(scene, target, pose, physics, material)
    for _ in range(_MAX_SECONDS):
        before = pose
        for _ in range(_SETTLE_RATE):
            system.step()
            if body.is_sleeping:  # PhysX moves it no more: the rest of the second would be idle
                break
        pose = body.entity_pose.to_transformation_matrix().astype(np.float64)
        if pose[2, 3] < -1.0:  # fell off the table
            return None
        if body.is_sleeping or _is_same_pose(before, pose):
            pose[:2, 3] = 0.0
            return pose if pose[2, 3] > 0 else None
    return None


def _is_same_pose(before: np.ndarray, after: np.ndarray) -> bool:
    turn = np.arccos(np.clip((np.trace(before[:3, :3].T @ after[:3, :3]) - 1) / 2, -1, 1))
    return bool(np.abs(after[:3, 3] - before[:3, 3]).max() < _MAX_DRIFT and turn < _MAX_TURN)


def _same_rest(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the same side of the object lies on the table."""
    cosine = float(np.clip(a[2, :3] @ b[2, :3], -1.0, 1.0))
    return bool(np.arccos(cosine) < _SAME_TILT)
