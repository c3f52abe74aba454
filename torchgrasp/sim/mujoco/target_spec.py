"""The target in a MuJoCo specification: convex parts, and the mass that all objects share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.solids import hull
from torchgrasp.sim.mujoco._mujoco import mujoco


@dataclass(frozen=True)
class Distribution:
    """How the mass of an object lies, its parts being of one density.

    Attributes:
        T_object_principal: (4, 4) centre of mass and principal axes in the object's frame.
        moments: (3,) m2, principal moments for a mass of 1 kg.
    """

    T_object_principal: np.ndarray
    moments: np.ndarray


def distribute(target: GraspObject) -> Distribution:
    """Centre of mass and inertia of an object's convex parts; where they overlap, both count, as in PhysX."""
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for part in target.parts:
        vertices, faces = hull(part.astype(np.float64))
        corners = vertices[faces] - vertices[0]  # tetrahedra with the first vertex
        share = np.linalg.det(corners) / 6
        total = corners.sum(axis=1)
        # Integrals of x and of x x^T over a tetrahedron with one corner at 0.
        centre = (share[:, None] * total).sum(0) / 4
        spread = np.einsum("t,tij,tik->jk", share, corners, corners)
        spread = (spread + np.einsum("t,tj,tk->jk", share, total, total)) / 20
        size, origin = share.sum(), vertices[0]
        volume += size
        first += centre + size * origin
        second += (
            spread + np.outer(centre, origin) + np.outer(origin, centre) + size * np.outer(origin, origin)
        )
    middle = first / volume
    spread = second / volume - np.outer(middle, middle)
    moments, axes = np.linalg.eigh(np.trace(spread) * np.eye(3) - spread)
    # The least that MuJoCo takes, so that flat objects and needles compile.
    moments = np.maximum(moments, 1e-8)
    axes[:, 0] *= np.linalg.det(axes)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, middle
    return Distribution(pose, moments)


def add_target(
    spec: Any,
    target: GraspObject,
    spread: Distribution,
    *,
    held: bool,
    contact: dict[str, Any],
) -> None:
    """Add the body `target`, whose frame is that of its principal axes; of 1 kg, until `set_physics`.

    Args:
        spec: to add to.
        target: the object.
        spread: how its mass lies.
        held: whether it stands where it is put; else it moves freely.
        contact: properties of its contacts, by name.
    """
    body = spec.worldbody.add_body(
        name="target", mass=1.0, inertia=spread.moments, explicitinertial=True, mocap=held
    )
    if not held:
        body.add_freejoint(name="target")
    rotation, centre = spread.T_object_principal[:3, :3], spread.T_object_principal[:3, 3]
    for i, part in enumerate(target.parts):
        vertices = (part - centre) @ rotation
        spec.add_mesh(
            name=f"part{i}", uservert=vertices.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        )
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"part{i}", **contact)
