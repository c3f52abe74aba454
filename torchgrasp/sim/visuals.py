"""Meshes of what a renderer shows: vertices, triangles, normals and texture coordinates as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from torchgrasp.objects.surface import face_normals

# Faces whose normals differ by less are shaded as one smooth surface: 40 degrees.
_CREASE = np.cos(np.radians(40.0))
_MAX_SHARED = 256
# Rings and sides: a capsule of 6 cm stays within 0.5 mm of the round one, at half the cost of 0.3 mm.
_SIDES = [16, 32]


@dataclass(frozen=True, eq=False)
class Visual:
    """A mesh as the renderer shows it, which shows front faces only.

    Attributes:
        vertices: (V, 3) float32 metres.
        faces: (F, 3) uint32.
        normals: (V, 3) float32.
        uvs: (V, 2) float32, a texture's repeats.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    normals: NDArray[np.float32]
    uvs: NDArray[np.float32]


def mesh_visual(vertices: NDArray, faces: NDArray, *, repeats: float, both_sides: bool = True) -> Visual:
    """A mesh with smooth normals where it is smooth and flat ones at its edges.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) indices.
        repeats: of the texture per metre.
        both_sides: whether it is seen from behind, too; each triangle then stands there twice.
    """
    normals, areas = face_normals(vertices.astype(np.float64), faces)
    used = areas > 0
    faces, normals, areas = faces[used], normals[used], areas[used]
    corner_normals = _corner_normals(vertices, faces, normals, areas)
    points = vertices[faces].reshape(-1, 3).astype(np.float32)
    uvs = _project(points, np.repeat(normals, 3, axis=0)) * repeats
    rows = np.concatenate((points, corner_normals, uvs), axis=-1).astype(np.float32)
    first, index = _distinct(rows)
    points, corner_normals, uvs = np.split(rows[first], (3, 6), axis=-1)
    index = index.reshape(-1, 3)
    if not both_sides:
        return Visual(points, index.astype(np.uint32), corner_normals, uvs)
    return Visual(
        np.concatenate((points, points)),
        np.concatenate((index, index[:, ::-1] + len(points))).astype(np.uint32),
        np.concatenate((corner_normals, -corner_normals)),
        np.concatenate((uvs, uvs)),
    )


def box_visual(half: NDArray, *, repeats: float = 0.0) -> Visual:
    """A box about the origin with (3,) half extents."""
    box = trimesh.creation.box(extents=2 * np.asarray(half))
    return mesh_visual(box.vertices, box.faces, repeats=repeats)


def capsule_visual(radius: float, length: float) -> Visual:
    """A capsule about the origin along z, `length` between the centres of its caps."""
    capsule = trimesh.creation.capsule(height=length, radius=radius, count=_SIDES)
    capsule.apply_translation(-capsule.bounds.mean(axis=0))
    return mesh_visual(capsule.vertices, capsule.faces, repeats=0.0)


def rectangle_visual(lower: NDArray, upper: NDArray, *, repeats: float) -> Visual:
    """A rectangle at z = 0 from (2,) lower to upper, its texture's rows along y."""
    (x0, y0), (x1, y1) = lower[:2], upper[:2]
    vertices = np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)])
    return mesh_visual(vertices, np.array([(0, 1, 2), (0, 2, 3)]), repeats=repeats)


def _corner_normals(vertices: NDArray, faces: NDArray, normals: NDArray, areas: NDArray) -> NDArray:
    """(3F, 3) normals of the faces' corners: the mean of the faces that meet there almost evenly."""
    _, place = _distinct(vertices[faces].reshape(-1, 3).astype(np.float32))
    own, weight = np.repeat(normals, 3, axis=0), np.repeat(areas, 3)
    order = np.argsort(place, kind="stable")
    count = np.bincount(place)
    start = np.cumsum(count) - count
    # All pairs of corners that share a place; where very many do, as at a fan's tip, each is flat.
    partners = np.where(count > _MAX_SHARED, 0, count)[place]
    one = np.repeat(np.arange(len(place)), partners)
    step = np.arange(len(one)) - np.repeat(np.cumsum(partners) - partners, partners)
    other = order[start[place[one]] + step]
    even = (own[one] * own[other]).sum(-1) > _CREASE
    one, other = one[even], other[even]
    added = own[other] * weight[other, None]
    total = np.stack([np.bincount(one, added[:, axis], len(place)) for axis in range(3)], axis=-1)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return np.where(length > 0, total / np.maximum(length, 1e-30), own)


def _distinct(rows: NDArray[np.float32]) -> tuple[NDArray, NDArray]:
    """Indices of the first of each of the different rows (N, C), and for each row (N,) which that is.

    Rows are told apart by 64-bit hashes of them, many times as fast as by sorting them as rows.
    """
    bits = np.ascontiguousarray(rows.round(6) + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    odd = np.random.default_rng(0).integers(2**63, size=bits.shape[1], dtype=np.uint64) * 2 + 1
    keys = (bits * odd).sum(axis=-1, dtype=np.uint64)
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    return first, index.reshape(-1)


def _project(points: NDArray, normals: NDArray) -> NDArray:
    """(N, 2) texture coordinates: points (N, 3) seen along the axis that their faces look at most."""
    axis = np.abs(normals).argmax(axis=-1)
    kept = np.array([(1, 2), (0, 2), (0, 1)])[axis]
    return np.take_along_axis(points, kept, axis=-1)
