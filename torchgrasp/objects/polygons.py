"""Faces of many corners, triangulated so that a concave one keeps its notches; readers' fans fill them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
import trimesh

from torchgrasp.objects.solids import Points

Polygon = Sequence[int]

_MAX_CORNERS = 5000  # of a concave face: the time grows with the square
_FLAT = 1e-9  # sine below which a corner is straight
_NOTCH = 0.01  # sine of the least inward turn that makes a face concave: most faces are not quite plane


def triangulate_concave(data: bytes, suffix: str, scene: trimesh.Scene) -> trimesh.Trimesh | None:
    """The mesh of a file with concave faces; None where a reader's triangles are right.

    Args:
        data: the file's content.
        suffix: of its name, in lower case.
        scene: what the reader made of it.
    """
    read = {".obj": _read_obj, ".ply": _read_ply}.get(suffix)
    found = read(data, scene) if read is not None else None
    if found is None:
        return None
    vertices, polygons, resolved = found
    if resolved and not _has_concave(vertices, polygons):
        return None
    return _triangulated(vertices, polygons)


def read_off(data: bytes) -> trimesh.Trimesh:
    """The mesh of an OFF file; trimesh's reader fails at faces of five corners and more beside NumPy 2.4."""
    text = re.sub(r"#[^\n]*", "", data.decode(errors="replace")).partition("OFF")[2]
    lines = [line.split() for line in text.splitlines() if line.strip()]
    if not lines:
        raise ValueError("there is no OFF heading, or nothing behind it")
    num_vertices, num_faces = int(lines[0][0]), int(lines[0][1])
    if min(num_vertices, num_faces) < 0 or num_vertices + num_faces > len(lines) - 1:
        raise ValueError(f"{num_vertices} vertices and {num_faces} faces in {len(lines) - 1} lines")
    corners = [[float(word) for word in line[:3]] for line in lines[1 : num_vertices + 1]]
    if any(len(each) < 3 for each in corners):
        raise ValueError("a vertex has fewer than three numbers")
    rows = lines[num_vertices + 1 : num_vertices + num_faces + 1]
    polygons = [[int(word) for word in row[1 : int(row[0]) + 1]] for row in rows]
    if any(len(each) < int(row[0]) for each, row in zip(polygons, rows, strict=True)):
        raise ValueError("a face has fewer corners than it announces")
    _check_corners(num_vertices, polygons)
    return _triangulated(np.asarray(corners, np.float64).reshape(-1, 3), polygons)


def _triangulated(vertices: Points, polygons: list[list[int]]) -> trimesh.Trimesh:
    faces = [triangle for each in polygons for triangle in triangulate(vertices, each)]
    return trimesh.Trimesh(vertices, np.array(faces, np.int64).reshape(-1, 3), process=False)


# Vertices, faces, and whether the reader finds the same vertices for them.
_Found = tuple[Points, list[list[int]], bool]


def _read_obj(data: bytes, scene: trimesh.Scene) -> _Found | None:
    if not re.search(rb"(?m)^[ \t]*f(?:(?:[ \t]+\S+){4}|[^\n]*[ \t](?:-|0+[/\s]))", data):
        return None  # triangles alone, counted from the file's first vertex, 1
    corners: list[list[float]] = []
    polygons: list[list[int]] = []
    resolved = True
    seen = 0
    for line in data.decode(errors="replace").replace("\\\n", " ").splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            corners.append([float(word) for word in words[:3]])
            resolved &= seen == 0
        elif kind == "f" and len(words) > 2:
            numbers = [int(word.partition("/")[0]) for word in words]
            # Negative ones count back from here, which trimesh takes for the file's end.
            seen += min(numbers) < 0
            polygons.append([number - 1 if number > 0 else len(corners) + number for number in numbers])
    return _checked(corners, polygons, resolved)


def _read_ply(data: bytes, scene: trimesh.Scene) -> _Found | None:
    raw = next(iter(scene.geometry.values())).metadata.get("_ply_raw", {})
    faces = raw.get("face", {}).get("data")
    names = faces.keys() if isinstance(faces, dict) else getattr(getattr(faces, "dtype", None), "names", None)
    name = next((name for name in names or () if name in ("vertex_index", "vertex_indices")), None)
    if faces is None or name is None:
        return None
    rows = faces[name] if isinstance(faces, dict) else faces[name]["f1"]
    if np.shape(rows)[1:] == (3,):
        return None
    vertex = raw["vertex"]["data"]
    corners = np.column_stack([np.asarray(vertex[axis], np.float64).ravel() for axis in "xyz"])
    return _checked(corners, [np.asarray(row).astype(int).tolist() for row in rows], True)


def _checked(
    corners: Sequence[Sequence[float]] | Points, polygons: list[list[int]], resolved: bool
) -> _Found | None:
    """None where no face has more than three corners; ValueError for corners that do not exist."""
    _check_corners(len(corners), polygons)
    if resolved and all(len(each) <= 3 for each in polygons):
        return None
    return np.asarray(corners, np.float64).reshape(-1, 3), polygons, resolved


def _check_corners(count: int, polygons: list[list[int]]) -> None:
    if any(not 0 <= corner < count for each in polygons for corner in each):
        raise ValueError(f"a face has a corner beyond the {count} vertices")


def _flatten(points: Points) -> Points:
    """(N, 2) points of a polygon (N, 3) in its plane, so that it runs counter-clockwise."""
    centred = points - points[0]
    normal = np.cross(centred, np.roll(centred, -1, axis=0)).sum(0)  # twice the area, by Newell
    length = np.linalg.norm(normal)
    if length == 0.0:
        return np.zeros((len(points), 2))
    normal /= length
    aside = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    aside /= np.linalg.norm(aside)
    return np.stack((centred @ aside, centred @ np.cross(normal, aside)), axis=1)


def _turns(flat: Points) -> Points:
    """(N,) sines by which a polygon (N, 2) turns left at its corners."""
    ahead = np.roll(flat, -1, axis=0) - flat
    behind = np.roll(ahead, 1, axis=0)
    cross = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    return cross / np.maximum(np.linalg.norm(ahead, axis=1) * np.linalg.norm(behind, axis=1), 1e-30)


def _has_concave(vertices: Points, polygons: list[list[int]]) -> bool:
    """Whether a face of more than three corners turns inwards at one of them."""
    for size in {len(each) for each in polygons} - {0, 1, 2, 3}:
        points = vertices[np.array([each for each in polygons if len(each) == size])]
        ahead = np.roll(points, -1, axis=1) - points
        ahead /= np.maximum(np.linalg.norm(ahead, axis=2, keepdims=True), 1e-30)
        turns = np.cross(np.roll(ahead, 1, axis=1), ahead)
        centred = points - points[:, :1]
        normal = np.cross(centred, np.roll(centred, -1, axis=1)).sum(1)  # Newell's
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        if ((turns * normal[:, None]).sum(2) < -_NOTCH).any():
            return True
    return False


def triangulate(vertices: Points, polygon: Polygon) -> Iterator[tuple[int, int, int]]:
    """Triangles of a face, by ears where it is concave (Meisters, 1975), by a fan elsewhere.

    Args:
        vertices: (V, 3).
        polygon: indices of its corners, in order, about in a plane. Its triangles turn the same way.
    """
    left = list(polygon)
    if len(left) > 3 and (_turns(flat := _flatten(vertices[left])) < -_FLAT).any():
        if len(left) > _MAX_CORNERS:
            raise ValueError(f"a concave face of {len(left)} corners: triangulate it where it was made")
        while len(left) > 3 and (ear := _find_ear(flat)) is not None:
            yield left[ear - 1], left[ear], left[(ear + 1) % len(left)]
            del left[ear]
            flat = np.delete(flat, ear, axis=0)
    yield from ((left[0], left[i], left[i + 1]) for i in range(1, len(left) - 1))


def _find_ear(flat: Points) -> int | None:
    """A corner whose triangle with its neighbours holds no other corner of the polygon (N, 2)."""
    turns = _turns(flat)
    for corner in np.flatnonzero(turns > _FLAT):
        a, b, c = flat[corner - 1], flat[corner], flat[(corner + 1) % len(flat)]
        inside = np.ones(len(flat), bool)
        for start, end in ((a, b), (b, c), (c, a)):
            way = end - start
            inside &= way[0] * (flat[:, 1] - start[1]) - way[1] * (flat[:, 0] - start[0]) >= 0
        inside &= (flat != a).any(1) & (flat != b).any(1) & (flat != c).any(1)
        if not inside.any():
            return int(corner)
    straight = np.flatnonzero(np.abs(turns) <= _FLAT)
    return int(straight[0]) if len(straight) else None
