"""Convex parts of a mesh: its bodies one by one, each split by coacd where it is not convex already."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from torchgrasp.objects.model import MAX_PART_VERTICES
from torchgrasp.objects.simplification import (
    Faces,
    Indices,
    boxes,
    connected_groups,
    diagonal,
    edges_at_holes,
    merge_cells,
    sides,
    simplify_closed,
    without_unused,
)
from torchgrasp.objects.solids import Points, hull
from torchgrasp.objects.surface import face_normals

_MAX_COACD_FACES = 2000  # full scans take coacd minutes
_NEARLY_CONVEX = 0.97  # share of its hull that a mesh fills
MAX_PARTS = 64  # of a mesh of several bodies
_MAX_SPLIT = 8  # bodies that coacd sees, the largest ones
_CRUMB = 0.1  # share of the object's length below which an open piece stands for itself
_COARSE = 0.3  # coacd's threshold from which on a body is taken for its hull


def convex_parts(vertices: Points, faces: Faces, *, concavity: float) -> tuple[Points, ...]:
    """Convex vertex clouds of at most 64 vertices that together stand for the mesh.

    Bodies, which share no vertex, are taken one by one: coacd would look for cuts between them. The
    smaller one is, the coarser it is split, so that `concavity` is of the whole. More than 64 parts of
    several bodies are merged, those first that lie closest.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) indices.
        concavity: coacd's threshold, 0.01 (many parts) to 1 (one).
    """
    bodies = split_bodies(vertices, faces)
    if len(bodies) == 1:
        pieces = _split_body(vertices, faces, concavity, _MAX_COACD_FACES)
        return tuple(piece for piece in map(reduce_hull, pieces) if piece is not None)
    size = diagonal(vertices)
    pieces = []
    for rank, (corners, triangles) in enumerate(bodies):
        threshold = concavity * size / diagonal(corners)
        if rank < _MAX_SPLIT and threshold < _COARSE:
            share = len(triangles) * _MAX_COACD_FACES // len(faces)
            pieces += _split_body(corners, triangles, threshold, max(share, 500))
        else:
            pieces.append(corners)
    parts = [piece for piece in map(reduce_hull, pieces) if piece is not None]
    return tuple(merge_parts(parts, MAX_PARTS))


def split_bodies(vertices: Points, faces: Faces) -> list[tuple[Points, Faces]]:
    """The bodies of a mesh, the largest first; what is open stays together, and cavities with their body.

    Open crumbs of a tenth of the length are bodies of their own, unless they are all that there is.

    Args:
        vertices: (V, 3), each used by a face.
        faces: (F, 3) indices, closed bodies with outward normals.
    """
    of_vertex, count = connected_groups(sides(faces), len(vertices))
    if count == 1:
        return [(vertices, faces)]
    owner = of_vertex[faces[:, 0]]
    group = _group(vertices, faces, of_vertex, count)[owner]
    bodies = [without_unused(vertices, faces[group == each]) for each in np.unique(group)]
    return sorted(bodies, key=lambda body: -diagonal(body[0]))


def _group(vertices: Points, faces: Faces, of_vertex: Indices, count: int) -> Indices:
    """(count,) the body to which each connected piece belongs."""
    owner = of_vertex[faces[:, 0]]
    is_open = np.zeros(count, bool)
    is_open[of_vertex[edges_at_holes(faces, len(vertices))[:, 0]]] = True
    low, high = boxes(vertices, of_vertex, count)
    group = np.arange(count)
    volume = np.bincount(owner, np.linalg.det(vertices[faces] - vertices.mean(0)), minlength=count)
    for cavity in np.flatnonzero((volume < 0) & ~is_open):
        around = ~is_open & (volume > 0) & (low <= low[cavity]).all(1) & (high >= high[cavity]).all(1)
        if around.any():
            group[cavity] = np.flatnonzero(around)[volume[around].argmin()]
    loose = is_open & (np.linalg.norm(high - low, axis=1) < _CRUMB * diagonal(vertices))
    area = np.bincount(owner, face_normals(vertices, faces)[1], minlength=count)
    if area[loose].sum() < _CRUMB * area.sum():
        is_open &= ~loose  # a soup of triangles is all that there is
    if is_open.any():
        group[is_open] = np.flatnonzero(is_open)[0]
    return group


def _split_body(vertices: Points, faces: Faces, concavity: float, max_faces: int) -> list[Points]:
    try:
        filled = _filled_share(vertices, faces)
    except QhullError:
        return []
    if abs(filled) > _NEARLY_CONVEX:
        return [vertices]
    return _decompose(vertices, faces if filled > 0 else faces[:, ::-1], concavity, max_faces)


def merge_parts(parts: list[Points], most: int) -> list[Points]:
    """At most `most` convex parts for more of them: pairs are merged whose hull adds the least volume.

    Args:
        parts: convex vertex clouds (Vi, 3).
        most: the number that may be left.
    """
    parts = list(parts)
    while len(parts) > most:
        parts = _merge_round(parts, len(parts) - most)
    return parts


def _merge_round(parts: list[Points], number: int) -> list[Points]:
    """The parts with at most `number` disjoint pairs of neighbours merged, the better half of the pairs."""
    centres = np.array([part.mean(0) for part in parts])
    volumes = [ConvexHull(part).volume for part in parts]
    _, near = KDTree(centres).query(centres, k=min(7, len(parts)))
    pairs = {(min(i, j), max(i, j)) for i, row in enumerate(np.asarray(near).tolist()) for j in row if i != j}
    joint = {pair: np.concatenate([parts[i] for i in pair]) for pair in sorted(pairs)}
    added = {
        pair: ConvexHull(points).volume - sum(volumes[i] for i in pair) for pair, points in joint.items()
    }
    free, merged = set(range(len(parts))), []
    for pair in sorted(added, key=added.__getitem__):
        if len(merged) == max(1, min(number, len(parts) // 4)):
            break
        if free.issuperset(pair):
            free -= set(pair)
            merged.append(reduce_hull(joint[pair]))
    return [parts[i] for i in sorted(free)] + [part for part in merged if part is not None]


def _filled_share(vertices: Points, faces: Faces) -> float:
    """The share of its hull that a mesh fills, negative for one that is inside out.

    A hole takes away the cone from the middle of the mesh to it: a pinhole in a scan hardly counts, the
    missing lid of a box takes a sixth.
    """
    shape = ConvexHull(vertices)
    triangles = vertices[faces] - vertices[shape.vertices].mean(axis=0)
    return float(np.linalg.det(triangles).sum() / 6) / shape.volume


def _decompose(vertices: Points, faces: Faces, concavity: float, max_faces: int) -> list[Points]:
    import coacd  # loads its shared library: only where a mesh needs it

    coacd.set_log_level("error")
    closed = simplify_closed(vertices, faces, max_faces=max_faces)
    corners, triangles = closed or merge_cells(vertices, faces, max_faces=max_faces)
    if len(triangles) < 4:
        return [vertices]
    pieces = coacd.run_coacd(
        coacd.Mesh(corners, triangles.astype(np.int32)),
        # coacd makes a solid of an open body first, whose ragged walls take hundreds of parts where they are
        # looked at closely. It would do so with most closed scans too, for they cut themselves somewhere:
        # four times slower, and 1 mm thicker.
        threshold=concavity if closed else min(2 * concavity, 1.0),
        preprocess_mode="off" if closed else "on",
        preprocess_resolution=25,
        # An eighth of its search for cuts costs half of its time and two parts more of thirty.
        mcts_nodes=5,
        mcts_iterations=20,
        max_ch_vertex=MAX_PART_VERTICES,
        decimate=True,
    )
    return [np.asarray(corners, np.float64) for corners, _ in pieces]


def reduce_hull(points: Points, max_vertices: int = MAX_PART_VERTICES) -> Points | None:
    """At most `max_vertices` hull vertices of (N, 3) points, chosen greedily; None if they are flat.

    Each step adds the vertex that stands out farthest, so what is cut off stays thin.
    """
    try:
        outer = hull(points)[0]
        if np.linalg.svd(outer - outer.mean(0), compute_uv=False)[-1] < 1e-5:
            return None
        if len(outer) <= max_vertices:
            return outer
        chosen = np.unique(np.concatenate((outer.argmin(0), outer.argmax(0)))).tolist()
        chosen += [int(np.random.default_rng(0).integers(len(outer)))] if len(chosen) < 4 else []
        while len(chosen) < max_vertices:
            planes = ConvexHull(outer[chosen], qhull_options="QJ").equations
            chosen.append(int((outer @ planes[:, :3].T + planes[:, 3]).max(1).argmax()))
        return hull(outer[chosen])[0]
    except QhullError:  # flat to machine precision
        return None
