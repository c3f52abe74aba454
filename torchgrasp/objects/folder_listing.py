"""Mesh files below a folder, and what their objects are called."""

from __future__ import annotations

import os
import warnings
from collections import Counter, deque
from pathlib import Path

from torchgrasp.errors import ObjectError
from torchgrasp.names import object_name, one_line
from torchgrasp.objects.meshes import MESH_SUFFIXES


def find_meshes(folder: Path) -> dict[str, Path]:
    """Mesh files below a folder by their objects' names, in the order of their paths.

    Links to folders are followed, and no folder is read twice. What begins with a dot is passed over: hidden
    folders, and the ``._`` files that macOS leaves beside others. An object has its file's path without the
    suffix for a name; files that differ in the suffix alone keep it.

    Raises:
        ObjectError: where there is no such folder, no mesh in it, or two files of one name.
    """
    if not folder.is_dir():
        raise ObjectError(f"{folder} is not a directory: give the folder that holds the mesh files.")
    files = sorted(_walk(folder))
    if not files:
        raise ObjectError(f"{folder} holds no mesh file: {', '.join(MESH_SUFFIXES)} are read.")
    stems = [object_name(file.relative_to(folder).with_suffix("")) for file in files]
    count = Counter(stems)
    named: dict[str, Path] = {}
    for file, stem in zip(files, stems, strict=True):
        name = stem if count[stem] == 1 else object_name(file.relative_to(folder))
        if name in named:
            raise ObjectError(f"{file} and {named[name]} would both be called {name!r}: rename one of them.")
        named[name] = file
    return named


def names_in_full(named: dict[str, Path], folder: Path) -> dict[str, str]:
    """The objects' names by what a list may call them: the name itself, or the file with its suffix."""
    full = {object_name(file.relative_to(folder)): name for name, file in named.items()}
    return full | {name: name for name in named}


def _walk(folder: Path) -> list[Path]:
    files: list[Path] = []
    seen: set[tuple[int, int]] = set()
    # Links come last: a folder that also lies here has its own path.
    waiting = deque([folder])
    while waiting:
        for here, folders, names in os.walk(waiting.popleft(), onerror=_warn):
            if not _is_first(here, seen):
                folders.clear()
                continue
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            waiting += [Path(here, name) for name in folders if os.path.islink(os.path.join(here, name))]
            files += [Path(here, name) for name in names if _is_mesh(name)]
    return files


def _is_first(here: str, seen: set[tuple[int, int]]) -> bool:
    """Whether a folder comes for the first time; it is then among those seen."""
    found = os.stat(here)
    key = (found.st_dev, found.st_ino)
    first = key not in seen
    seen.add(key)
    return first


def _is_mesh(name: str) -> bool:
    return not name.startswith(".") and name.lower().endswith(MESH_SUFFIXES)


def _warn(error: OSError) -> None:
    warnings.warn(one_line(f"Left out: {error.filename} cannot be listed ({error.strerror})."), stacklevel=4)
