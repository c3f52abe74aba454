"""Resting poses proved by physics: computed once an object, so that no reset has to wait for it."""

from __future__ import annotations

import numpy as np
import sapien
from sapien import physx

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.table import build_table
from torchgrasp.sim.world import build_target

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


def _drop(target: GraspObject, candidate: np.ndarray, physics: Physics) -> np.ndarray | None:
    """(4, 4) pose in which the object stays for a second, None where it never does."""
    system = physx.PhysxCpuSystem()
    system.timestep = 1.0 / _SETTLE_RATE
    scene = sapien.Scene([system])
    material = physx.PhysxMaterial(physics.friction, physics.friction, 0.0)
    build_table(scene, material)
    pose = candidate.copy()
    pose[:3, 3] += _PLACE
    pose[2, 3] += _DROP_HEIGHT
    body = build_target(scene, target, pose, physics, material)
    for _ in range(_MAX_SECONDS):
        before = pose
        for _ in range(_SETTLE_RATE):
            system.step()
        pose = body.entity_pose.to_transformation_matrix().astype(np.float64)
        if _is_same_pose(before, pose):
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
