"""Signed distance of an object as a grid: distances and directions for thousands of points at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import depth_in_parts, sample_surface
from torchgrasp.sim.kinematics import Array

_SPACING = 0.0125  # metres between grid points
_MARGIN = 0.11  # metres around the object that the grid covers
_SAMPLES = 3000  # of the surface
_MAX_FIELDS = 2048  # of some 60 kB
_fields: dict[str, DistanceField] = {}


@dataclass(frozen=True)
class DistanceField:
    """Signed distance to an object's surface, positive outside, metres, in the object frame.

    Attributes:
        origin: (3,) the grid's first point.
        values: (X, Y, Z) float32 distances.
        radius: of the ball about the frame's origin that holds the object, metres.
    """

    origin: Array
    values: np.ndarray
    radius: float

    def sample(self, points: Array) -> tuple[Array, Array]:
        """(N,) distances and (N, 3) gradients at (N, 3) points, of the trilinear interpolation.

        Outside the grid its nearest value is taken, and the way to it added.
        """
        at = (points - self.origin) / _SPACING
        _, ny, nz = self.values.shape
        inside = np.clip(at, 0.0, np.array(self.values.shape) - 1.001)
        low = inside.astype(np.int64)
        x, y, z = (inside - low).T
        corner = (low[:, 0] * ny + low[:, 1]) * nz + low[:, 2]
        flat = self.values.reshape(-1)
        (a, b), (c, d) = ([flat[corner + (i * ny + j) * nz] for j in (0, 1)] for i in (0, 1))
        (e, f), (g, h) = ([flat[corner + (i * ny + j) * nz + 1] for j in (0, 1)] for i in (0, 1))
        along_z = [top - bottom for bottom, top in ((a, e), (b, f), (c, g), (d, h))]
        a, b, c, d = (v + z * w for v, w in zip((a, b, c, d), along_z, strict=True))
        near, far = a + y * (b - a), c + y * (d - c)
        p, q, r, s = along_z
        rise = (p + y * (q - p)) * (1.0 - x) + (r + y * (s - r)) * x
        slope = np.stack((far - near, (b - a) * (1.0 - x) + (d - c) * x, rise), axis=-1) / _SPACING
        beyond = np.linalg.norm(at - inside, axis=-1)
        return near + x * (far - near) + _SPACING * beyond, slope


def distance_field(target: GraspObject) -> DistanceField:
    """The field of an object; those of the last 2048 objects are kept."""
    field = _fields.pop(target.content_hash, None) or _build(target)
    _fields[target.content_hash] = field
    if len(_fields) > _MAX_FIELDS:
        _fields.pop(next(iter(_fields)))
    return field


def _build(target: GraspObject) -> DistanceField:
    vertices = target.vertices.astype(np.float64)
    low, high = vertices.min(axis=0) - _MARGIN, vertices.max(axis=0) + _MARGIN
    axes = [np.arange(a, b + _SPACING, _SPACING) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = grid.reshape(-1, 3)
    surface, _ = sample_surface(vertices, target.faces, _SAMPLES, np.random.default_rng(0))
    distance = np.asarray(KDTree(surface).query(points)[0])
    within = np.all((points > vertices.min(axis=0)) & (points < vertices.max(axis=0)), axis=-1)
    inside = np.flatnonzero(within)
    covered = inside[depth_in_parts(points[inside], target.parts) > 0.0]
    distance[covered] *= -1.0
    values = distance.reshape(grid.shape[:3]).astype(np.float32)
    radius = float(np.linalg.norm(vertices, axis=-1).max())
    return DistanceField(low, values, radius)
