"""Mesh files to solids: read, checked by name, split into convex parts."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from torchgrasp.errors import ObjectError
from torchgrasp.objects.model import MAX_PART_VERTICES
from torchgrasp.objects.solids import Points, Solid, hull

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
_LARGEST = 2.0  # metres; anything larger was drawn in another unit
_SMALLEST = 0.005
MAX_FACES = 50_000  # of the surface that a camera sees
_HAND_WIDTH, _SHORTEST, _LONGEST = 0.065, 0.06, 0.25  # metres, see hand_scale
_MAX_COACD_FACES = 4000  # full scans take coacd minutes
_NEARLY_CONVEX = 0.97  # share of its hull that a mesh fills


def read_solid(path: Path, *, scale: float, concavity: float, resize: bool = False) -> Solid:
    """The mesh file as a solid in metres, its convex parts by coacd; ObjectError names a file that fails.

    What could be mended is told by a warning: vertices that no face needs, open or inverted surfaces,
    more than 50,000 triangles.

    Args:
        path: an obj, stl, ply, glb or off file.
        scale: factor to metres.
        concavity: coacd's threshold, 0.01 (many parts) to 1 (one).
        resize: scale the object on, see `hand_scale`, whatever its unit.
    """
    mesh = _read(path)
    _drop_unused(path, mesh)
    mesh = _tidy(path, mesh)
    if len(mesh.faces) < 4:
        raise ObjectError(f"{path} has {len(mesh.faces)} usable triangles: a body needs 4 or more.")
    mesh.apply_scale(scale)
    if resize:
        mesh.apply_scale(hand_scale(np.asarray(mesh.vertices, np.float64)))
    _check_size(path, np.asarray(mesh.extents, np.float64), scale)
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    parts = convex_parts(vertices, faces, concavity=concavity)
    if not parts:
        raise ObjectError(f"{path} encloses no volume: give a closed mesh or remove the file.")
    return Solid(vertices, faces, parts)


def hand_scale(vertices: Points) -> float:
    """The factor that makes an object one for the hand (Sec. 6.2: shapes are resized to be graspable).

    At most 6.5 cm across where it is narrowest and 25 cm long; what is shorter than 6 cm grows to that
    length as far as its width allows. 1 for all else.

    Args:
        vertices: (V, 3) of the object.
    """
    try:
        shape = ConvexHull(vertices)
    except QhullError:
        return 1.0  # flat: refused later, by name
    corners = vertices[shape.vertices]
    narrowest = float(np.ptp(corners @ shape.equations[:, :3].T, axis=0).min())
    longest = float(np.ptp(vertices, axis=0).max())
    most = min(_HAND_WIDTH / narrowest, _LONGEST / longest)
    return min(most, max(1.0, _SHORTEST / longest))


def _drop_unused(path: Path, mesh: trimesh.Trimesh) -> None:
    """Refuse vertices without a place; those that no triangle uses are only left out, with a warning."""
    # Zero times a sum is NaN where one of its numbers is NaN or infinite.
    bad = np.isnan(np.asarray(mesh.vertices, np.float64).sum(axis=1) * 0.0)
    if bad[np.asarray(mesh.faces)].any():
        raise ObjectError(
            f"{path} has {int(bad.sum())} vertices that are NaN or infinite: repair or remove the file."
        )
    if bad.any():
        warnings.warn(f"{path}: {int(bad.sum())} NaN vertices that no face uses are left out.", stacklevel=3)
        mesh.remove_unreferenced_vertices()


def _read(path: Path) -> trimesh.Trimesh:
    options = {"skip_materials": True} if path.suffix.lower() == ".obj" else {}
    try:
        return trimesh.load_mesh(path, process=False, **options)
    except Exception as error:  # trimesh's readers raise whatever the damage makes them meet
        raise ObjectError(
            f"{path} cannot be read as a mesh ({type(error).__name__}: {error}):"
            " export it again or remove it."
        ) from error


def _tidy(path: Path, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Vertices merged, flat triangles dropped, not too many left, holes closed, normals outward."""
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    was_closed = mesh.is_watertight
    if len(mesh.faces) > MAX_FACES:
        before = len(mesh.faces)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
        mesh = trimesh.Trimesh(*simplify(vertices, faces, max_faces=MAX_FACES), process=False)
        _tell(path, f"has {before} triangles: {len(mesh.faces)} are kept.")
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) < 4:
        return mesh
    with np.errstate(invalid="ignore", divide="ignore"):  # a flat mesh is refused later, by name
        if not mesh.is_watertight and not was_closed:
            closed = mesh.fill_holes()
            _tell(path, "is open: its holes are closed." if closed else "is open: it is taken as a shell.")
        inverted = mesh.is_watertight and mesh.is_winding_consistent and _signed_volume(mesh) < 0
        if not mesh.is_winding_consistent or _signed_volume(mesh) < 0:
            trimesh.repair.fix_normals(mesh, multibody=True)
        if inverted:
            _tell(path, "is inside out: its faces are turned.")
    return mesh


def _tell(path: Path, what: str) -> None:
    warnings.warn(f"{path} {what}", stacklevel=4)


def _signed_volume(mesh: trimesh.Trimesh) -> float:
    """Cubic metres enclosed; negative where the normals point inwards, zero for what is flat."""
    return float(np.linalg.det(np.asarray(mesh.triangles, np.float64)).sum() / 6)


def _check_size(path: Path, extents: Points, scale: float) -> None:
    largest, smallest = float(extents.max()), float(extents.min())
    if largest > _LARGEST:
        raise ObjectError(
            f"{path} is {largest:.3g} m long with scale={scale:g}: it looks drawn in millimetres, try"
            f" scale={scale * 0.001:g}."
        )
    if largest < _SMALLEST:
        raise ObjectError(
            f"{path} is {largest:.2g} m long with scale={scale:g}: give the scale= that yields metres."
        )
    if smallest < 1e-4:
        raise ObjectError(f"{path} is flat ({smallest:.2g} m thick): a body needs volume.")


def convex_parts(vertices: Points, faces: NDArray[np.int64], *, concavity: float) -> tuple[Points, ...]:
    """Convex vertex clouds of at most 64 vertices that together stand for the mesh."""
    try:
        convex = _filled_share(vertices, faces) > _NEARLY_CONVEX
    except QhullError:
        return ()
    pieces = [vertices] if convex else _decompose(vertices, faces, concavity)
    reduced = [reduce_hull(piece) for piece in pieces]
    return tuple(piece for piece in reduced if piece is not None)


def _filled_share(vertices: Points, faces: NDArray[np.int64]) -> float:
    """The share of its hull that a mesh fills.

    A hole takes away the cone from the middle of the mesh to it: a pinhole in a scan hardly counts, the
    missing lid of a box takes a sixth.
    """
    shape = ConvexHull(vertices)
    triangles = vertices[faces] - vertices[shape.vertices].mean(axis=0)
    return abs(float(np.linalg.det(triangles).sum() / 6)) / shape.volume


def _decompose(vertices: Points, faces: NDArray[np.int64], concavity: float) -> list[Points]:
    import coacd  # loads its shared library: only where a mesh needs it

    coacd.set_log_level("error")
    corners, triangles = simplify(vertices, faces, max_faces=_MAX_COACD_FACES)
    # A third of coacd's own search costs a third of its time and two parts more on a mug.
    pieces = coacd.run_coacd(
        coacd.Mesh(corners, triangles.astype(np.int32)),
        threshold=concavity,
        max_ch_vertex=MAX_PART_VERTICES,
        decimate=True,
        mcts_nodes=10,
        mcts_iterations=50,
    )
    return [np.asarray(corners, np.float64) for corners, _ in pieces]


def simplify(
    vertices: Points, faces: NDArray[np.int64], *, max_faces: int
) -> tuple[Points, NDArray[np.int64]]:
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
        _, owner, counts = np.unique(code, return_inverse=True, return_counts=True)
        owner = owner.ravel()
        kept = np.stack([np.bincount(owner, weights=column) / counts for column in vertices.T], axis=1)
        simple = owner[faces]
        a, b, c = simple.T
        simple = simple[(a != b) & (b != c) & (c != a)]
        simple = simple[np.unique(np.sort(simple, axis=1), axis=0, return_index=True)[1]]
        cell *= 1.25
    return kept, simple


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
