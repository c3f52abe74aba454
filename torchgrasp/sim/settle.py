"""Resting poses proved by physics: computed once an object, so that no reset has to wait for it."""

from __future__ import annotations

import numpy as np
import sapien
from sapien import physx

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.table import build_table
from torchgrasp.sim.world import Physics, build_target

_SETTLE_RATE = 120
_SETTLE_SECONDS = 2.0
_WATCH_SECONDS = 1.0
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
    """(4, 4) pose after settling, None where the object is still on its way after two seconds."""
    system = physx.PhysxCpuSystem()
    system.timestep = 1.0 / _SETTLE_RATE
    scene = sapien.Scene([system])
    material = physx.PhysxMaterial(physics.friction, physics.friction, 0.0)
    build_table(scene, material)
    start = candidate.copy()
    start[:3, 3] += _PLACE + (0.0, 0.0, _DROP_HEIGHT)
    body = build_target(scene, target, start, physics, material)
    for _ in range(int(_SETTLE_SECONDS * _SETTLE_RATE)):
        system.step()
    before = body.entity_pose.to_transformation_matrix().astype(np.float64)
    for _ in range(int(_WATCH_SECONDS * _SETTLE_RATE)):
        system.step()
    after = body.entity_pose.to_transformation_matrix().astype(np.float64)
    turn = np.arccos(np.clip((np.trace(before[:3, :3].T @ after[:3, :3]) - 1) / 2, -1, 1))
    if np.abs(after[:3, 3] - before[:3, 3]).max() > _MAX_DRIFT or turn > _MAX_TURN or after[2, 3] < 0:
        return None
    after[:2, 3] = 0.0
    return after


def _same_rest(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the same side of the object lies on the table."""
    cosine = float(np.clip(a[2, :3] @ b[2, :3], -1.0, 1.0))
    return bool(np.arccos(cosine) < _SAME_TILT)
