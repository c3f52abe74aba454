"""Where two fingers can touch an object: antipodal pairs of its surface, and what open pads meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchgrasp.objects.gripper import MAX_OPENING, pad_rays
from torchgrasp.objects.solids import hull
from torchgrasp.objects.surface import RayTarget, depth_in_parts, face_normals, sample_surface, thin

Array = NDArray[np.float64]

MAX_WIDTH = 0.075
MIN_WIDTH = 0.0005
MAX_TILT = 0.3  # radians between a contact's normal and the closing axis
PAD_DEPTH = 0.003  # metres behind the first contact that a pad still meets
_BURIED = 0.0015  # a surface point deeper than this in a part is inside the object


@dataclass(frozen=True, eq=False)
class Body:
    """An object as the hand meets it; its centre of mass is the origin.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) indices.
        parts: the convex parts.
        rays: what rays from the pads are cast at.
        dense: (D, 3) samples, about 4 mm apart, of both what is seen and what physics collides with.
    """

    vertices: Array
    faces: NDArray
    parts: Sequence[np.ndarray]
    rays: RayTarget
    dense: Array

    @classmethod
    def of(
        cls, vertices: Array, faces: NDArray, parts: Sequence[np.ndarray], rng: np.random.Generator
    ) -> Body:
        """The body of a surface and its convex parts; `rng` decides which points are sampled."""
        seen, _ = sample_surface(vertices, faces, 15000, rng)
        clouds = [seen]
        for part in parts:
            corners, triangles = hull(np.asarray(part, np.float64))
            clouds.append(sample_surface(corners, triangles, 10000 // len(parts), rng)[0])
        dense = np.concatenate((thin(np.concatenate(clouds), 0.004), *parts))
        return cls(vertices, faces, parts, RayTarget(vertices, faces), dense)


def contact_pairs(body: Body, rng: np.random.Generator) -> tuple[Array, Array]:
    """Middles (P, 3) and unit closing axes (P, 3) of antipodal pairs no wider than MAX_WIDTH."""
    normals, _ = face_normals(body.vertices, body.faces)
    first, chosen = sample_surface(body.vertices, body.faces, 2500, rng)
    outer = depth_in_parts(first, body.parts) < _BURIED
    first, normal = first[outer], normals[chosen[outer]]
    tilt = rng.normal(size=first.shape)
    axis = -normal + np.tan(MAX_TILT * rng.random((len(first), 1)) ** 2) * unit(np.cross(normal, tilt))
    axis = unit(axis)
    # The wall just touched, and the far side of all that fits between the pads: a mug's wall, or the mug.
    through, through_face = body.rays.cast(first + 1e-5 * axis, axis)
    back, back_face = body.rays.cast(first + (MAX_WIDTH + MIN_WIDTH) * axis, -axis)
    across = MAX_WIDTH + MIN_WIDTH - back
    across = np.where(np.abs(across - through) < 1e-4, np.inf, across)
    width, face = np.concatenate((through, across)), np.concatenate((through_face, back_face))
    first, axis = np.tile(first, (2, 1)), np.tile(axis, (2, 1))
    aligned = np.abs((normals[face] * axis).sum(1)) > np.cos(MAX_TILT)
    good = np.isfinite(width) & (width > MIN_WIDTH) & (width < MAX_WIDTH) & aligned
    good = rng.permutation(np.flatnonzero(good))[:1200]
    return first[good] + axis[good] * width[good, None] / 2, axis[good]


def pad_contacts(poses: Array, body: Body, *, depth: float = PAD_DEPTH) -> tuple[Array, Array, Array]:
    """What the open hand's pads meet: their ways (B, 2) to it, coverage (B,) and tilt (B,).

    The ways are inf where a pad meets nothing, the coverage is that of the less covered pad, the tilt
    that of the contact that is less square. What lies up to `depth` metres behind the first contact
    counts as met.
    """
    origins, directions = pad_rays(poses)
    distance, face = body.rays.cast(origins.reshape(-1, 3), directions.reshape(-1, 3))
    distance = distance.reshape(origins.shape[:3])
    distance[distance > MAX_OPENING] = np.inf
    gap = distance.min(2)
    met = distance < gap[..., None] + depth
    normals = face_normals(body.vertices, body.faces)[0][face.reshape(distance.shape)]
    facing = -(normals * directions).sum(-1, keepdims=True)
    mean = unit((np.where(facing < 0, -normals, normals) * met[..., None]).sum(2))
    tilt = np.arccos(np.clip(-(mean * directions[:, :, 0]).sum(-1), -1, 1)).max(1)
    return gap, met.mean(2).min(1), tilt


def unit(vectors: Array) -> Array:
    """(*, 3) vectors of length 1, zero where there is none."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
