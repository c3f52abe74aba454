"""Closed shapes with the convex parts that stand for them in physics.

A round thing has a fine surface and coarse parts: each part's vertices are moved out by half the
error of its chords, so that it lies inside the surface as far as outside (below a millimetre).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from torchgrasp.objects.model import MAX_PART_VERTICES

Points = NDArray[np.float64]
Profile = Sequence[tuple[float, float]]  # (radius, z) from the bottom upwards

SURFACE_SEGMENTS = 48
_PART_SEGMENTS = 32


@dataclass(frozen=True, eq=False)
class Solid:
    """A surface, (V, 3) and (F, 3), and its convex parts, each (Vi, 3), in metres."""

    vertices: Points
    faces: NDArray[np.int64]
    parts: tuple[Points, ...]

    def moved(self, offset: Sequence[float] | Points, rotation: Points | None = None) -> Solid:
        """This solid turned by `rotation` (3, 3) about the origin, then moved by `offset` (3,)."""
        turn = np.eye(3) if rotation is None else rotation
        parts = tuple(part @ turn.T + np.asarray(offset) for part in self.parts)
        return Solid(self.vertices @ turn.T + np.asarray(offset), self.faces, parts)

    def scaled(self, scale: Sequence[float]) -> Solid:
        """This solid stretched by positive factors along x, y and z."""
        factors = np.asarray(scale)
        return Solid(self.vertices * factors, self.faces, tuple(part * factors for part in self.parts))


def join(*solids: Solid) -> Solid:
    """The solids as one; pieces may touch or overlap."""
    starts = np.cumsum([0, *(len(solid.vertices) for solid in solids[:-1])])
    faces = [solid.faces + start for solid, start in zip(solids, starts, strict=True)]
    parts = tuple(part for solid in solids for part in solid.parts)
    return Solid(np.concatenate([solid.vertices for solid in solids]), np.concatenate(faces), parts)


def hull(points: Points) -> tuple[Points, NDArray[np.int64]]:
    """Vertices (V, 3) and outward faces (F, 3) of the convex hull of (N, 3) points."""
    shape = ConvexHull(points)
    index = np.full(len(points), -1)
    index[shape.vertices] = np.arange(len(shape.vertices))
    triangles = points[shape.simplices]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = (normals * shape.equations[:, :3]).sum(1) < 0
    simplices = np.where(inward[:, None], shape.simplices[:, ::-1], shape.simplices)
    return points[shape.vertices], index[simplices]


def box(size: Sequence[float]) -> Solid:
    """A box of edge lengths `size` (3,) about the origin."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    vertices, faces = hull(signs * np.asarray(size) / 2)
    return Solid(vertices, faces, (vertices,))


def ring(radius: float, z: float, angles: Points) -> Points:
    """(len(angles), 3) points of a circle about z; a single one where the radius is zero."""
    if radius == 0.0:
        return np.array([[0.0, 0.0, z]])
    return np.stack((radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), z)), axis=1)


def revolve(profile: Profile, segments: int = SURFACE_SEGMENTS) -> tuple[Points, NDArray[np.int64]]:
    """The closed surface of a (radius, z) profile turned about z, from axis to axis, material on its left.

    The profile starts and ends at radius 0 and runs upwards outside (downwards inside a hollow).
    """
    angles = np.arange(segments) * 2 * math.pi / segments
    rings = [ring(radius, z, angles) for radius, z in profile]
    starts = np.cumsum([0, *map(len, rings)])
    faces = []
    for low, high, i in zip(rings[:-1], rings[1:], range(len(rings)), strict=False):
        here = np.arange(segments) % len(low) + starts[i]
        here_next = (np.arange(segments) + 1) % len(low) + starts[i]
        above = np.arange(segments) % len(high) + starts[i + 1]
        above_next = (np.arange(segments) + 1) % len(high) + starts[i + 1]
        if len(low) > 1:
            faces.append(np.stack((here, here_next, above), axis=1))
        if len(high) > 1:
            faces.append(np.stack((here_next, above_next, above), axis=1))
    return np.concatenate(rings), np.concatenate(faces)


def chord_gain(step: float) -> float:
    """Factor on a radius that splits the error of chords of `step` radians evenly in and out."""
    return 2.0 / (1.0 + math.cos(step / 2))


def band_part(profile: Profile) -> Points:
    """The convex part, at most 64 vertices, of a convex (radius, z) profile turned about z."""
    rings = sum(radius > 0 for radius, _ in profile)
    segments = min(_PART_SEGMENTS, (MAX_PART_VERTICES - len(profile) + rings) // rings)
    angles = np.arange(segments) * 2 * math.pi / segments
    gain = chord_gain(2 * math.pi / segments)
    return np.concatenate([ring(radius * gain, z, angles) for radius, z in profile])


def lathe(profile: Profile, bands: Sequence[Profile]) -> Solid:
    """A full solid of revolution: fine surface from `profile`, one convex part for each band."""
    closed = [(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])]
    if profile[0][0] == 0.0:
        closed = closed[1:]
    if profile[-1][0] == 0.0:
        closed = closed[:-1]
    vertices, faces = revolve(closed)
    return Solid(vertices, faces, tuple(band_part(band) for band in bands))


def cylinder(radius: float, height: float) -> Solid:
    """A cylinder about z, centred at the origin."""
    profile = [(radius, -height / 2), (radius, height / 2)]
    return lathe(profile, [profile])


def vessel(outer: Profile, inner: Profile, *, sectors: int) -> Solid:
    """A hollow of revolution, open at the top: a full bottom and walls of `sectors` parts a level.

    `outer` and `inner` rise level by level, as many points each; below inner[0] all is solid.
    """
    closed = [(0.0, outer[0][1]), *outer, *reversed(inner), (0.0, inner[0][1])]
    vertices, faces = revolve(closed)
    floor = band_part([outer[0], (outer[0][0], inner[0][1])])
    parts = [floor]
    step = 2 * math.pi / sectors
    for level in range(len(outer) - 1):
        parts += [_wall_part(outer, inner, level, i * step, step) for i in range(sectors)]
    return Solid(vertices, faces, tuple(parts))


def _wall_part(outer: Profile, inner: Profile, level: int, start: float, step: float) -> Points:
    """One sector of a wall: the outside follows its arc, the inside is a chord, half its error out."""
    fine = start + np.array([0.0, 0.5, 1.0]) * step
    ends = fine[[0, 2]]
    out_gain, in_gain = chord_gain(step / 2), chord_gain(step)
    rings = [ring(r * out_gain, z, fine) for r, z in outer[level : level + 2]]
    rings += [ring(r * in_gain, z, ends) for r, z in inner[level : level + 2]]
    return np.concatenate(rings)


def tube(path: Points, width: Points | float, depth: Points | float, *, segments: int = 10) -> Solid:
    """An elliptic tube along a path (N, 3) in the x-z plane: `width` along y, `depth` across.

    Both may change along the path, (N,).
    """
    ahead = np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    across = np.cross(ahead, (0.0, 1.0, 0.0))
    angles = np.arange(segments) * 2 * math.pi / segments
    halves = [np.broadcast_to(size, len(path))[:, None, None] / 2 for size in (width, depth)]
    side = halves[0] * np.sin(angles)[:, None] * np.array((0.0, 1.0, 0.0))
    rings = path[:, None] + halves[1] * np.cos(angles)[None, :, None] * across[:, None] + side
    parts = tuple(np.concatenate(rings[i : i + 2]) for i in range(len(path) - 1))
    return Solid(rings.reshape(-1, 3), tube_faces(len(path), segments), parts)


def tube_faces(rings: int, segments: int) -> NDArray[np.int64]:
    """Faces of a closed tube of `rings` x `segments` vertices, ends included."""
    a = np.arange(segments)
    b = (a + 1) % segments
    sides = [
        np.concatenate((np.stack((b, a, a + segments), 1), np.stack((b + segments, b, a + segments), 1)))
        + i * segments
        for i in range(rings - 1)
    ]
    fan = np.stack((np.zeros(segments - 2, int), a[1:-1], a[2:]), axis=1)
    return np.concatenate((*sides, fan, fan[:, ::-1] + (rings - 1) * segments))


def mass_properties(parts: Sequence[Points]) -> tuple[float, Points]:
    """Volume (m3) and centroid (3,) of the convex parts, each of the same density."""
    volumes, centres = [], []
    for part in parts:
        vertices, faces = hull(part)
        triangles = vertices[faces] - vertices[0]
        sixth = np.linalg.det(triangles) / 6
        volumes.append(sixth.sum())
        centres.append(vertices[0] + (sixth[:, None] * triangles.sum(1) / 4).sum(0) / sixth.sum())
    weights = np.asarray(volumes)
    return float(weights.sum()), (weights[:, None] * np.asarray(centres)).sum(0) / weights.sum()
