"""Meshes with fewer triangles, and scans without the pinholes that leave them open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from torchgrasp.objects.solids import Points

if TYPE_CHECKING:
    from manifold3d import Manifold

Faces = NDArray[np.int64]  # (F, 3) indices of vertices
Indices = NDArray[np.int64]

_PINHOLE = 0.005  # share of the mesh's diagonal
_LEAST_TOLERANCE, _MOST_TOLERANCE = 1e-5, 0.02  # shares of the mesh's diagonal
_STEP, _LARGE_STEP, _LEAST_STEP = 1.3, 3.0, 1.05  # factors by which the tolerance grows
_MANY = 100_000  # triangles, of which a call takes a second or more


def simplify(vertices: Points, faces: Faces, *, max_faces: int) -> tuple[Points, Faces]:
    """The mesh with at most `max_faces` triangles; as it is where it has no more.

    A closed surface stays closed: edges are collapsed that move it least, see `simplify_closed`. For any
    other, vertices are merged, see `merge_cells`.

    Args:
        vertices: (V, 3).
        faces: (F, 3) indices.
        max_faces: 4 or more.
    """
    if len(faces) <= max_faces:
        return vertices, faces
    closed = simplify_closed(vertices, faces, max_faces=max_faces)
    return merge_cells(vertices, faces, max_faces=max_faces) if closed is None else closed


def simplify_closed(vertices: Points, faces: Faces, *, max_faces: int) -> tuple[Points, Faces] | None:
    """A closed surface with at most `max_faces` triangles, closed again; None for any other surface.

    Closed is a surface in which each edge belongs to two triangles that turn the same way. The distance
    by which it may move begins at a hundred-thousandth of the diagonal, and grows by a third until the
    triangles are few enough, faster on more than 100,000 that hardly become fewer. A step to less than
    half of `max_faces` is taken back, and smaller ones are tried.

    Args:
        vertices: (V, 3).
        faces: (F, 3) indices.
        max_faces: 4 or more.
    """
    solid = _as_manifold(vertices, faces)
    if solid is None:
        return None
    size = diagonal(vertices)
    tolerance, step = _LEAST_TOLERANCE * size, _STEP
    while solid.num_tri() > max_faces and tolerance < _MOST_TOLERANCE * size:
        smaller = solid.simplify(tolerance)
        if 2 * smaller.num_tri() < max_faces and step > _LEAST_STEP:
            tolerance /= step**0.5
            step **= 0.5
            continue
        hardly = smaller.num_tri() > max(0.9 * solid.num_tri(), _MANY)
        step = _LARGE_STEP if hardly else min(step, _STEP)
        solid = smaller
        tolerance *= step
    if not 4 <= solid.num_tri() <= max_faces:
        return None
    mesh = solid.to_mesh64()
    corners = np.asarray(mesh.vert_properties, np.float64)[:, :3]
    return corners, np.asarray(mesh.tri_verts).astype(np.int64)


def _as_manifold(vertices: Points, faces: Faces) -> Manifold | None:
    from manifold3d import Error, Manifold, Mesh64  # only where a mesh needs it

    # Copies, for it takes no array that is read-only.
    solid = Manifold(Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C")))
    return solid if solid.status() == Error.NoError else None


def merge_cells(vertices: Points, faces: Faces, *, max_faces: int) -> tuple[Points, Faces]:
    """The mesh with at most `max_faces` triangles: vertices merged to the mean of their grid cell.

    No vertex moves farther than a cell's diagonal. Cells begin at 1/200 of the longest side and grow by
    a quarter until the triangles are few enough: on a surface of 50,000 triangles that is about 1 % of
    the longest side, 2 mm on an object of 20 cm.
    """
    lower = vertices.min(axis=0)
    cell = float(np.ptp(vertices, axis=0).max()) / 200
    kept, simple = vertices, faces
    while len(simple) > max_faces:
        cells = np.floor((vertices - lower) / cell).astype(np.int64)
        # One number a cell: sorting those takes a tenth of the time of sorting rows.
        code = (cells[:, 0] * 1024 + cells[:, 1]) * 1024 + cells[:, 2]
        _, owner = np.unique(code, return_inverse=True)
        kept, simple = _merge(vertices, faces, owner.ravel())
        simple = simple[np.unique(np.sort(simple, axis=1), axis=0, return_index=True)[1]]
        cell *= 1.25
    return kept, simple


def close_pinholes(vertices: Points, faces: Faces) -> tuple[Points, Faces]:
    """The mesh with each hole closed that is no larger than 0.5 % of its diagonal, 1 mm of 20 cm.

    The corners of such a hole become one vertex. Two triangles that lie in one another then, the sides of
    a fold, are left out. A piece that is no larger itself, such as a loose triangle, stays as it is.

    Args:
        vertices: (V, 3).
        faces: (F, 3) indices.
    """
    most = _PINHOLE * diagonal(vertices)
    while len(rim := edges_at_holes(faces, len(vertices))):
        hole, holes = connected_groups(rim, len(vertices))
        piece, pieces = connected_groups(sides(faces), len(vertices))
        closed = _box_sizes(vertices, hole, holes)[hole] <= most
        closed &= _box_sizes(vertices, piece, pieces)[piece] > most
        if not closed[rim[:, 0]].any():
            break
        owner = np.arange(len(vertices))
        owner[closed] = len(vertices) + hole[closed]
        vertices, faces = _merge(vertices, faces, np.unique(owner, return_inverse=True)[1].ravel())
        _, first, times = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        faces = faces[np.sort(first[times % 2 == 1])]
    return without_unused(vertices, faces)


def _box_sizes(vertices: Points, group: Indices, count: int) -> Points:
    """(G,) the diagonal of each group's box."""
    low, high = boxes(vertices, group, count)
    return np.linalg.norm(high - low, axis=1)


def _merge(vertices: Points, faces: Faces, owner: Indices) -> tuple[Points, Faces]:
    """Vertices of one owner become their mean; triangles that are edges then are left out."""
    counts = np.bincount(owner)
    kept = np.stack([np.bincount(owner, weights=column) / counts for column in vertices.T], axis=1)
    a, b, c = owner[faces].T
    return kept, owner[faces][(a != b) & (b != c) & (c != a)]


def edges_at_holes(faces: Faces, count: int) -> Faces:
    """(E, 2) edges of an odd number of triangles; none where the surface is closed.

    Args:
        faces: (F, 3) indices.
        count: number of vertices.
    """
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    code, times = np.unique(edges[:, 0] * count + edges[:, 1], return_counts=True)
    odd = code[times % 2 == 1]
    return np.stack([odd // count, odd % count], axis=1)


def sides(faces: Faces) -> Indices:
    """(2 F, 2) two edges of each triangle, which join what its three do."""
    return faces[:, [0, 1, 1, 2]].reshape(-1, 2)


def connected_groups(edges: Indices, count: int) -> tuple[Indices, int]:
    """(V,) the group of each vertex, those that edges join, and the number of groups.

    Args:
        edges: (E, 2) indices.
        count: number of vertices.
    """
    joined = coo_array((np.ones(len(edges), bool), edges.T), shape=(count, count))
    groups, of_vertex = connected_components(joined, directed=False)
    return of_vertex, groups


def boxes(vertices: Points, group: Indices, count: int) -> tuple[Points, Points]:
    """(G, 3) the lowest and the highest coordinates of each group of vertices.

    Args:
        vertices: (V, 3).
        group: (V,) of each vertex.
        count: number of groups.
    """
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, group, vertices)
    np.maximum.at(high, group, vertices)
    return low, high


def without_unused(vertices: Points, faces: Faces) -> tuple[Points, Faces]:
    """The mesh without vertices that no triangle has.

    Args:
        vertices: (V, 3).
        faces: (F, 3) indices.
    """
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3).astype(np.int64)


def diagonal(points: Points) -> float:
    """Of the (N, 3) points' bounding box."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))
