"""Poses in which an object may rest on a table, from the facets of its convex hull.

Candidates only: friction and rolling decide, so the simulator keeps those that lie still.
"""

from __future__ import annotations

import numpy as np
import roma
import torch
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from torchgrasp.objects.solids import hull
from torchgrasp.objects.surface import face_normals

Array = NDArray[np.float64]

_COPLANAR = np.deg2rad(2.5)
_EQUIVALENT = np.deg2rad(40.0)  # leaves a lying cylinder with some eight rolls
_ROUNDING = 5e-4  # metres by which an engine's hull may miss a vertex
_MIN_TILT = 0.04  # radians that the object must be tipped before it falls over an edge
_MIN_PROBABILITY = 0.02
_MAX_POSES = 12


def resting_poses(points: Array) -> tuple[Array, Array]:
    """`T_world_object` (K, 4, 4) on z = 0 and probabilities (K,), most probable first; K >= 1.

    A pose's probability is the solid angle, seen from the centre of mass, of the hull facets that end
    in it: its own, those of unstable facets nearest in direction, and those of equivalent poses.

    Args:
        points: (N, 3) metres, all vertices of the physics parts; the centre of mass is the origin.
    """
    vertices, faces = hull(points)
    normals, weights, stable = _facets(vertices, faces)
    if not stable.any():
        stable = _heights(vertices, normals) == _heights(vertices, normals).min()
    keepers, probability = _merge(normals, weights, stable)
    keep = probability >= min(_MIN_PROBABILITY, probability.max())
    keepers, probability = keepers[keep][:_MAX_POSES], probability[keep][:_MAX_POSES]
    return _lay_down(vertices, normals[keepers]), probability / probability.sum()


def nearby_rests(points: Array, poses: Array, count: int, rng: np.random.Generator) -> Array:
    """Poses (K, count, 4, 4) about each of the candidates (K, 4, 4) in which physics may leave the object.

    A candidate lies on the mean of nearly coplanar facets of the exact hull, but an engine rounds hulls: a
    pen ends up to 30 degrees from where it was laid. So the object is laid on hulls that differ by as much.
    On a broad face it stays as it is.

    Args:
        points: (N, 3) metres, all vertices of the physics parts; the centre of mass is the origin.
        poses: (K, 4, 4) `T_world_object`.
        count: of poses about each candidate.
        rng: decides how the hulls differ.
    """
    vertices, _ = hull(points)
    rests = []
    for _ in range(count):
        rounded, faces = hull(vertices + rng.uniform(-_ROUNDING, _ROUNDING, vertices.shape))
        normals, areas = face_normals(rounded, faces)
        normals, faces = normals[areas > 0], faces[areas > 0]
        height = (normals * rounded[faces[:, 0]]).sum(1)
        ends = [_bearing_facet(down, normals, height) for down in -poses[:, 2, :3]]
        rests.append(_lay_down(vertices, normals[ends]))
    return np.stack(rests, axis=1)


def _bearing_facet(down: Array, normals: Array, height: Array) -> int:
    """The facet that an object ends on for gravity along `down` (3,); the centre sinks at every turn."""
    while True:
        facing = normals @ down
        facet = int(np.where(facing > 1e-9, height / np.maximum(facing, 1e-9), np.inf).argmin())
        if facing[facet] > 1 - 1e-9:
            return facet
        down = normals[facet]


def _facets(vertices: Array, faces: NDArray) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Normals (M, 3), solid angles (M,) and stability (M,) of nearly coplanar groups of hull faces."""
    normals, areas = face_normals(vertices, faces)
    angles = _solid_angles(vertices[faces])
    left = areas > 0
    groups = []
    for seed in np.argsort(-areas):
        if left[seed]:
            group = left & (normals @ normals[seed] > np.cos(_COPLANAR))
            left &= ~group
            groups.append(group)
    mean = np.stack([(normals[group] * areas[group, None]).sum(0) for group in groups])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    stable = [_is_stable(vertices[np.unique(faces[group])], n) for group, n in zip(groups, mean, strict=True)]
    return mean, np.array([angles[group].sum() for group in groups]), np.array(stable)


def _solid_angles(triangles: Array) -> Array:
    """(F,) steradians of (F, 3, 3) triangles seen from the origin (van Oosterom and Strackee, 1983)."""
    a, b, c = triangles.transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    over = np.abs((a * np.cross(b, c)).sum(1))
    under = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return 2 * np.arctan2(over, under)


def _is_stable(support: Array, normal: Array) -> bool:
    """Whether the origin lies above the support (S, 3) with a margin, for gravity along `normal`."""
    height = float((support @ normal).max())
    flat = support - np.outer(support @ normal, normal)
    basis = np.linalg.svd(normal[None])[2][1:]
    edges = ConvexHull(flat @ basis.T).equations[:, 2]
    return bool((-edges).min() > height * np.tan(_MIN_TILT))


def _heights(vertices: Array, normals: Array) -> Array:
    """(M,) heights of the origin above the lowest vertex, for gravity along each normal."""
    return (normals @ vertices.T).max(1)


def _merge(normals: Array, weights: Array, stable: NDArray) -> tuple[NDArray[np.int64], Array]:
    """Indices of representative stable facets and their shares of the solid angle, largest first."""
    candidates = np.flatnonzero(stable)
    ends = candidates[(normals @ normals[candidates].T).argmax(1)]
    share = np.bincount(ends, weights=weights, minlength=len(weights)) / weights.sum()
    keepers: list[int] = []
    total: list[float] = []
    left = stable.copy()
    for facet in candidates[np.argsort(-share[candidates])]:
        if left[facet]:
            group = left & (normals @ normals[facet] > np.cos(_EQUIVALENT))
            left &= ~group
            keepers.append(int(facet))
            total.append(float(share[group].sum()))
    order = np.argsort(-np.asarray(total), kind="stable")
    return np.asarray(keepers)[order], np.asarray(total)[order]


def _lay_down(vertices: Array, normals: Array) -> Array:
    """Poses (K, 4, 4) by the least rotation that turns each normal downwards."""
    down = torch.tensor((0.0, 0.0, -1.0), dtype=torch.float64).expand(len(normals), 3)
    source = torch.from_numpy(np.ascontiguousarray(normals))
    axis = torch.linalg.cross(source, down)
    norm = axis.norm(dim=-1, keepdim=True)
    # Where the normal points straight up, any horizontal axis turns it over.
    axis = torch.where(norm > 1e-9, axis / norm.clamp_min(1e-9), axis.new_tensor((1.0, 0.0, 0.0)))
    angle = torch.atan2(norm, (source * down).sum(-1, keepdim=True))
    poses = np.tile(np.eye(4), (len(normals), 1, 1))
    poses[:, :3, :3] = roma.rotvec_to_rotmat(axis * angle).numpy()
    poses[:, 2, 3] = -(poses[:, 2, :3] @ vertices.T).min(1)
    return poses
