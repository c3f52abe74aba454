"""Questions to a triangle mesh: samples of it, rays at it, and whether parts cover a point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from torchgrasp.objects.model import GraspObject

Points = NDArray[np.float64]
_NO_HIT = 1e30  # embree answers a distance of 1e37 where a ray meets nothing


def face_normals(vertices: Points, faces: NDArray) -> tuple[Points, Points]:
    """Unit normals (F, 3), zero for degenerate faces, and areas (F,) in square metres."""
    triangles = vertices[faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-30)[:, None], length / 2


def sample_surface(
    vertices: Points, faces: NDArray, count: int, rng: np.random.Generator
) -> tuple[Points, NDArray[np.int64]]:
    """`count` points (count, 3), uniform over the area, and the face (count,) of each."""
    _, areas = face_normals(vertices, faces)
    chosen = rng.choice(len(faces), size=count, p=areas / areas.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = vertices[faces[chosen]].transpose(1, 0, 2)
    return a + u * (b - a) + v * (c - a), chosen


_samples: dict[str, Points] = {}
_MAX_SAMPLES = 512


def surface_points(target: GraspObject) -> Points:
    """(512, 3) points on the object's surface, object frame, the same at every call.

    Those of the last 512 objects are kept.
    """
    points = _samples.pop(target.content_hash, None)
    if points is None:
        vertices = target.vertices.astype(np.float64)
        points, _ = sample_surface(vertices, target.faces, 512, np.random.default_rng(0))
    _samples[target.content_hash] = points
    if len(_samples) > _MAX_SAMPLES:
        _samples.pop(next(iter(_samples)))
    return points


def thin(points: Points, spacing: float) -> Points:
    """One of the (N, 3) points for each occupied cube of edge `spacing` metres, in a fixed order."""
    _, first = np.unique(np.floor(points / spacing).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def depth_in_parts(points: Points, parts: Sequence[np.ndarray]) -> Points:
    """(N,) metres by which each point lies inside the deepest of the convex parts; negative outside."""
    depth = np.full(len(points), -np.inf)
    for part in parts:
        planes = ConvexHull(part).equations
        depth = np.maximum(depth, -(points @ planes[:, :3].T + planes[:, 3]).max(1))
    return depth


class RayTarget:
    """A mesh at which rays are cast on the CPU (embree).

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) indices.
    """

    def __init__(self, vertices: Points, faces: NDArray):
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(vertices[faces], np.float32))

    def cast(self, origins: Points, directions: Points) -> tuple[Points, NDArray[np.int32]]:
        """Distances (N,) to the first hit along unit directions, inf for none, and the faces hit (-1)."""
        hits = self._scene.run(
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
            output=True,
        )
        distance = np.where(hits["tfar"] > _NO_HIT, np.inf, hits["tfar"].astype(np.float64))
        return distance, hits["primID"]
