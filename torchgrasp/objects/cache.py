"""Built objects on disk: one npz a file, named by what it was built from, written whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from torchgrasp.objects.model import GraspObject

_STRINGS = ("name", "family", "licence", "content_hash")
_ARRAYS = (
    "vertices",
    "faces",
    "grasps",
    "grasp_quality",
    "resting_poses",
    "resting_probability",
    "centre_of_mass",
)


def default_cache_dir() -> Path:
    """``$TORCHGRASP_CACHE/objects``, else ``torchgrasp/objects`` in the user's cache directory."""
    if root := os.environ.get("TORCHGRASP_CACHE"):
        return Path(root).expanduser() / "objects"
    user = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(user).expanduser() / "torchgrasp" / "objects"


def cache_key(*parts: object) -> str:
    """A digest of plain values (numbers, strings, tuples) that tell one build from another.

    >>> cache_key("mug", 3) == cache_key("mug", 3), cache_key("mug", 3) == cache_key("mug", 4)
    (True, False)
    """
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:20]


def load_or_build(path: Path, build: Callable[[], GraspObject]) -> GraspObject:
    """The object in `path`, or a fresh one that is then stored there.

    A damaged file is built again, with a warning; where the directory cannot be written, the object is
    returned all the same, with a warning.
    """
    if path.exists():
        try:
            return load(path)
        except Exception as error:  # whatever a damaged zip or array raises, the remedy is the same
            warnings.warn(f"Cached object {path} is damaged ({error}): it is built again.", stacklevel=2)
    built = build()
    try:
        save(path, built)
    except OSError as error:
        warnings.warn(
            f"Object {built.name} could not be cached in {path.parent} ({error}): it will be built each"
            " time. Give cache_dir= or set TORCHGRASP_CACHE to a directory that can be written.",
            stacklevel=2,
        )
    return built


def save(path: Path, item: GraspObject) -> None:
    """Write the object to `path` so that no reader ever sees half of it."""
    arrays = {name: getattr(item, name) for name in _ARRAYS}
    arrays |= {name: np.array(getattr(item, name)) for name in _STRINGS}
    arrays["volume"] = np.array(item.volume)
    arrays["part_vertices"] = np.concatenate(item.parts)
    arrays["part_sizes"] = np.array([len(part) for part in item.parts])
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".partial")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise


def load(path: Path) -> GraspObject:
    """The object that `save` wrote; raises on a damaged file."""
    with np.load(path, allow_pickle=False) as file:
        stored = {name: file[name] for name in file.files}
    parts = np.split(stored["part_vertices"], np.cumsum(stored["part_sizes"])[:-1])
    arrays = {name: stored[name] for name in _ARRAYS}
    return GraspObject(
        name=str(stored["name"]),
        family=str(stored["family"]),
        parts=tuple(parts),
        volume=float(stored["volume"]),
        licence=str(stored["licence"]),
        content_hash=str(stored["content_hash"]),
        **arrays,
    )
