"""What is grasped: one object with its surface, its physics parts, its grasps and its resting poses."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

MAX_PART_VERTICES = 64  # PhysX cooks convex shapes of up to 64 vertices for both CPU and GPU contacts


@dataclass(frozen=True, eq=False)
class GraspObject:
    """One rigid object in metres; the object frame has the centre of mass at its origin.

    Attributes:
        name: unique within the sets of one kind, e.g. ``mug-train-00017``.
        family: the kind of shape, e.g. ``mug``; for files, the folder's name.
        vertices: (V, 3) float32, the surface that a camera sees.
        faces: (F, 3) int32 into `vertices`, outward normals where the mesh has an inside. Closed
            pieces may overlap: the first hit of a ray from outside is right nevertheless.
        parts: convex vertex clouds (Vi, 3) float32 of at most 64 vertices, for the physics.
        grasps: (G, 4, 4) float32, `T_object_ee`: z approach, y finger opening, pads near z = 0.1034.
        grasp_quality: (G,) float32 in [0, 1].
        resting_poses: (K, 4, 4) float32, `T_world_object` with the object on z = 0 and its centre of
            mass above the origin; candidates from geometry, most probable first.
        resting_probability: (K,) float32, sums to 1.
        centre_of_mass: (3,) float32, in the frame of the source mesh: subtracted to make this frame.
        volume: cubic metres, of the parts.
        licence: of the shape.
        content_hash: of all arrays above.
    """

    name: str
    family: str
    vertices: Floats
    faces: NDArray[np.int32]
    parts: tuple[Floats, ...]
    grasps: Floats
    grasp_quality: Floats
    resting_poses: Floats
    resting_probability: Floats
    centre_of_mass: Floats
    volume: float
    licence: str
    content_hash: str

    @property
    def size(self) -> Floats:
        """(3,) extents along the object's axes, metres."""
        return np.ptp(self.vertices, axis=0)


def content_hash(arrays: Iterable[np.ndarray]) -> str:
    """Hex digest of the arrays' shapes, types and bytes, in order."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]
