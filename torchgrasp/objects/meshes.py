"""Mesh files to solids: tidied, checked by name, given convex parts."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from torchgrasp.errors import ObjectError
from torchgrasp.objects.decomposition import convex_parts
from torchgrasp.objects.mesh_files import read_triangles
from torchgrasp.objects.simplification import Faces, close_pinholes, simplify
from torchgrasp.objects.solids import Points, Solid

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
READING_VERSION = 2  # part of the name of every cache file of a mesh: raise it when one gives another solid
_LARGEST = 2.0  # metres; anything larger was drawn in another unit
_UNITS = {"centimetres": 0.01, "millimetres": 0.001}
_LIKELY = (0.02, 0.6)  # metres, the length of what is grasped
_SMALLEST = 0.005
MAX_FACES = 50_000  # of the surface that a camera sees
_HAND_WIDTH, _SHORTEST, _LONGEST = 0.065, 0.06, 0.25  # metres, see hand_scale
_MAX_HOLES = 0.25  # share of the edges at which a mesh may end to have its holes closed


def read_solid(path: Path, *, scale: float, concavity: float, resize: bool = False) -> Solid:
    """The mesh file as a solid in metres, its convex parts by coacd; ObjectError names a file that fails.

    What could be mended is told by a warning: vertices that no face needs, pinholes, open or inverted
    surfaces, more than 50,000 triangles.

    Args:
        path: an obj, stl, ply, glb or off file.
        scale: factor to metres.
        concavity: coacd's threshold, 0.01 (many parts) to 1 (one).
        resize: scale the object on, see `hand_scale`, whatever its unit.
    """
    mesh = read_triangles(path)
    _drop_unused(path, mesh)
    mesh = _tidy(path, mesh)
    if len(mesh.faces) < 4:
        raise ObjectError(f"{path} has {len(mesh.faces)} usable triangles: a body needs 4 or more.")
    mesh.apply_scale(scale)
    if resize:
        mesh.apply_scale(hand_scale(np.asarray(mesh.vertices, np.float64)))
    _check_size(path, np.asarray(mesh.extents, np.float64), scale)
    vertices, faces = _arrays(mesh)
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


def _tidy(path: Path, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Vertices merged, flat triangles dropped, not too many left, holes closed, normals outward."""
    mesh = _without_flat_triangles(trimesh.Trimesh(mesh.vertices, mesh.faces, process=True))
    if len(mesh.faces) >= 4 and not mesh.is_watertight:
        closed = trimesh.Trimesh(*close_pinholes(*_arrays(mesh)), process=False)
        if len(closed.faces) < len(mesh.faces):
            _tell(path, "has pinholes: they are closed.")
            mesh = closed
    was_closed = mesh.is_watertight
    if len(mesh.faces) > MAX_FACES:
        before = len(mesh.faces)
        mesh = trimesh.Trimesh(*simplify(*_arrays(mesh), max_faces=MAX_FACES), process=False)
        mesh = _without_flat_triangles(mesh)
        _tell(path, f"has {before} triangles: {len(mesh.faces)} are kept.")
    if len(mesh.faces) < 4:
        return mesh
    with np.errstate(invalid="ignore", divide="ignore"):  # a flat mesh is refused later, by name
        if not mesh.is_watertight and not was_closed:
            closed = _open_share(mesh) < _MAX_HOLES and mesh.fill_holes()
            _tell(path, "is open: its holes are closed." if closed else "is open: it is taken as a shell.")
        inverted = mesh.is_watertight and mesh.is_winding_consistent and _signed_volume(mesh) < 0
        if not mesh.is_winding_consistent or _signed_volume(mesh) < 0:
            trimesh.repair.fix_normals(mesh, multibody=True)
        if inverted:
            _tell(path, "is inside out: its faces are turned.")
    return mesh


def _without_flat_triangles(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same mesh with each triangle once, those that are lines left out, and no vertices but theirs."""
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def _arrays(mesh: trimesh.Trimesh) -> tuple[Points, Faces]:
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def _open_share(mesh: trimesh.Trimesh) -> float:
    """The share of the edges that only one triangle has."""
    return float((np.bincount(mesh.edges_unique_inverse) == 1).mean())


def _tell(path: Path, what: str) -> None:
    warnings.warn(f"{path} {what}", stacklevel=4)


def _signed_volume(mesh: trimesh.Trimesh) -> float:
    """Cubic metres enclosed; negative where the normals point inwards, zero for what is flat."""
    return float(np.linalg.det(np.asarray(mesh.triangles, np.float64)).sum() / 6)


def _check_size(path: Path, extents: Points, scale: float) -> None:
    largest, smallest = float(extents.max()), float(extents.min())
    if largest > _LARGEST:
        raise ObjectError(f"{path} is {largest:.3g} m long with scale={scale:g}: {_advise(largest, scale)}.")
    if largest < _SMALLEST:
        raise ObjectError(
            f"{path} is {largest:.2g} m long with scale={scale:g}: give the scale= that yields metres."
        )
    if smallest < 1e-4:
        raise ObjectError(f"{path} is flat ({smallest:.2g} m thick): a body needs volume.")


def _advise(largest: float, scale: float) -> str:
    """What to do with an object that is too long (metres): the scales that give it a likely length."""
    low, high = _LIKELY
    likely = [
        f"{unit}, try scale={scale * to_metres:g}"
        for unit, to_metres in _UNITS.items()
        if low <= largest * to_metres <= high
    ]
    return f"it looks drawn in {', or in '.join(likely)}" if likely else "give the scale= that yields metres"
