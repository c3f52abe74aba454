"""The triangles of a mesh file, whatever the file holds: sizes are checked before they are believed."""

from __future__ import annotations

import io
import logging
import os
import stat
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from torchgrasp.errors import ObjectError
from torchgrasp.objects.glb import prepare_glb
from torchgrasp.objects.polygons import read_off, triangulate_concave

MAX_BYTES = 500_000_000
MAX_TRIANGLES = 5_000_000
_LFS = b"version https://git-lfs.github.com/spec/"
_STL_HEADER, _STL_TRIANGLE = 84, 50  # bytes
_WITH_MATERIALS = (".obj", ".ply", ".glb")  # formats that name pictures and materials, which nobody needs


def read_bytes(path: Path) -> bytes:
    """A file's content; ObjectError for what is no file, cannot be read, or is larger than 500 MB."""
    try:
        # A pipe without a writer would wait for one.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            state = os.fstat(file.fileno())
            if not stat.S_ISREG(state.st_mode):
                raise ObjectError(f"{path} is no file but a folder, pipe or device: remove it.")
            data = file.read(MAX_BYTES + 1) if state.st_size <= MAX_BYTES else b""
    except OSError as error:
        raise ObjectError(f"{path} cannot be read ({error.strerror}): restore it.") from error
    if max(len(data), state.st_size) > MAX_BYTES:
        raise ObjectError(
            f"{path} has {state.st_size / 1e6:.0f} MB and at most {MAX_BYTES / 1e6:.0f} MB are read: simplify"
            " the mesh."
        )
    return data


def read_triangles(path: Path) -> trimesh.Trimesh:
    """The file's mesh as it stands there, its faces valid; ObjectError says what is wrong with a file."""
    data = read_bytes(path)
    if data.startswith(_LFS):
        raise ObjectError(f"{path} is a Git LFS pointer, not the mesh itself: fetch it by `git lfs pull`.")
    try:
        mesh = _parse(path, data)
    except ObjectError:
        raise
    except Exception as error:  # trimesh's readers raise whatever the damage makes them meet
        raise ObjectError(
            f"{path} cannot be read as a mesh ({type(error).__name__}: {_first_line(error)}):"
            " export it again or remove it."
        ) from error
    faces = np.asarray(mesh.faces)
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(mesh.vertices):
        raise ObjectError(
            f"{path} has faces of vertices {faces.min()} to {faces.max()} where {len(mesh.vertices)} exist:"
            " export it again or remove it."
        )
    return mesh


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0][:200]


def _parse(path: Path, data: bytes) -> trimesh.Trimesh:
    suffix = path.suffix.lower()
    if suffix == ".glb":
        data = prepare_glb(path, data, max_count=3 * MAX_TRIANGLES)
    elif suffix == ".stl":
        data = _cut_stl(path, data)
    elif suffix == ".ply":
        _check_ply(path, data)
    options: dict[str, Any] = {"skip_materials": True} if suffix in _WITH_MATERIALS else {}
    with _silence():
        if suffix == ".off":
            scene = trimesh.Scene(read_off(data))
        else:
            scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], process=False, **options)
        _check_scene(path, scene)
        return triangulate_concave(data, suffix, scene) or scene.to_mesh()


@contextmanager
def _silence() -> Iterator[None]:
    """Keep to ourselves what readers log and warn of: what matters of it is an ObjectError."""
    log = logging.getLogger("trimesh")
    before, log.disabled = log.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.disabled = before


def _check_scene(path: Path, scene: trimesh.Scene) -> None:
    """Refuse what has no faces, or more of them than can be prepared."""
    meshes = {name: len(each.faces) for name, each in scene.geometry.items() if hasattr(each, "faces")}
    if not any(meshes.values()):
        if any(len(each.vertices) for each in scene.geometry.values()):
            raise ObjectError(f"{path} is a point cloud, it has no faces: reconstruct its surface first.")
        raise ObjectError(f"{path} has 0 usable triangles: a body needs 4 or more.")
    # One mesh may stand in many places of a scene.
    placed = sum(meshes.get(scene.graph[node][1], 0) for node in scene.graph.nodes_geometry)
    if placed > MAX_TRIANGLES:
        raise ObjectError(
            f"{path} has {placed} triangles and at most {MAX_TRIANGLES} are read: simplify the mesh."
        )


def _cut_stl(path: Path, data: bytes) -> bytes:
    """A binary STL file without the bytes behind its triangles; text and whole files as they are."""
    is_text = data[:5].lower() == b"solid" and b"facet" in data[:4096].lower()
    if len(data) < _STL_HEADER:
        return data
    (count,) = struct.unpack_from("<I", data, _STL_HEADER - 4)
    end = _STL_HEADER + count * _STL_TRIANGLE
    if end == len(data) or is_text:
        return data
    if end > len(data):
        held = (len(data) - _STL_HEADER) // _STL_TRIANGLE
        raise ObjectError(
            f"{path} is cut off or no STL file: it announces {count} triangles and holds {held}. Fetch it"
            " again or remove it."
        )
    return data[:end]


def _check_ply(path: Path, data: bytes) -> None:
    """Refuse numbers of elements that are negative or of which not each can have a byte."""
    header = data[: data.find(b"end_header")]
    for line in header.splitlines():
        words = line.split()
        if len(words) == 3 and words[0] == b"element" and not 0 <= int(words[2]) <= len(data):
            raise ObjectError(
                f"{path} announces {int(words[2])} of {words[1].decode(errors='replace')} in {len(data)}"
                " bytes: export it again or remove it."
            )
