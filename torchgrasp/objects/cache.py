"""Built objects on disk: one npz a file, named by what it was built from, written whole or not at all."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import math
import os
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TypeVar

import numpy as np

from torchgrasp.documents import read_text
from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.names import to_path
from torchgrasp.objects.model import GraspObject, content_hash

T = TypeVar("T")
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
    """``$TORCHGRASP_CACHE/objects``, else ``torchgrasp/objects`` in the user's cache directory.

    Raises:
        ConfigError: where the user has no home directory, as in some containers.
    """
    for name, inner in (("TORCHGRASP_CACHE", "objects"), ("XDG_CACHE_HOME", "torchgrasp/objects")):
        if root := os.environ.get(name):
            return to_path(name, root) / inner
    try:
        return Path.home() / ".cache" / "torchgrasp" / "objects"
    except RuntimeError as error:
        raise ConfigError(
            "This user has no home directory where built objects could be kept: set TORCHGRASP_CACHE to a "
            "directory that can be written to."
        ) from error


def cache_key(*parts: object) -> str:
    """A digest of plain values (numbers, strings, tuples) that tell one build from another.

    >>> cache_key("mug", 3) == cache_key("mug", 3), cache_key("mug", 3) == cache_key("mug", 4)
    (True, False)
    """
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:20]


def load_or_build(path: Path, build: Callable[[], GraspObject]) -> GraspObject:
    """The object in `path`, or a fresh one that is then stored there.

    That it cannot be built is remembered as well: the ObjectError comes again without another attempt.
    """
    refused = refusal_path(path)

    def attempt() -> GraspObject:
        if (reason := read_refusal(path)) is not None:
            raise ObjectError(reason)
        try:
            return build()
        except ObjectError as error:
            text = str(error).encode(errors="backslashreplace")
            with contextlib.suppress(OSError):  # an unwritable cache only costs the next attempt
                write_whole(refused, lambda file: file.write(text))
            raise

    return cached(path, attempt, load=load, save=save)


def refusal_path(path: Path) -> Path:
    """Where it is remembered why the object of `path` cannot be built."""
    return path.with_suffix(".refused")


def read_refusal(path: Path) -> str | None:
    """Why the object of `path` cannot be built, None where that is not remembered."""
    refused = refusal_path(path)
    if not refused.exists():
        return None
    return read_text(refused, "delete it, and the object is tried again", error=ObjectError)


def cached(
    path: Path, build: Callable[[], T], *, load: Callable[[Path], T], save: Callable[[Path, T], None]
) -> T:
    """What `path` holds, or what `build` makes, which is then stored; several processes build it once.

    A damaged file is built again, with a warning; where the directory cannot be written, the result is
    returned all the same, with a warning.
    """
    if path.exists():
        try:
            return load(path)
        except Exception as error:  # whatever a damaged zip or array raises, the remedy is the same
            warnings.warn(f"Cached {path} is damaged ({error}): it is built again.", stacklevel=2)
            with contextlib.suppress(OSError):
                path.unlink()
    with locked(path):
        if path.exists():  # another process built it meanwhile
            with contextlib.suppress(Exception):
                return load(path)
        built = build()
        try:
            save(path, built)
        except OSError as error:
            warnings.warn(
                f"{path.name} could not be cached in {path.parent} ({error}): it will be built each time."
                " Give cache_dir= or set TORCHGRASP_CACHE to a directory that can be written.",
                stacklevel=2,
            )
    return built


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of `path` against other processes; the system frees that of a process that dies.

    Where files cannot be locked (a read-only directory, some network disks), nobody waits: work is then
    done twice at worst, because files are written whole.
    """
    lock = path.with_suffix(".lock")
    handle = _acquire(lock)
    try:
        yield
    finally:
        if handle is not None:
            with contextlib.suppress(OSError):
                lock.unlink()  # before it is freed: who waits for it finds that it is gone and asks anew
            os.close(handle)


def _acquire(lock: Path) -> int | None:
    while True:
        try:
            lock.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(lock, os.O_CREAT | os.O_RDWR)
        except OSError:
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            if os.path.samestat(os.fstat(handle), os.stat(lock)):
                return handle
        except FileNotFoundError:  # its last owner removed it while this process waited
            pass
        except OSError:
            os.close(handle)
            return None
        os.close(handle)


def write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let `write` fill a file so that no reader ever sees half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".partial")
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise


def save(path: Path, item: GraspObject) -> None:
    """Write the object to `path`, whole or not at all."""
    arrays = {name: getattr(item, name) for name in _ARRAYS}
    arrays |= {name: np.array(getattr(item, name)) for name in _STRINGS}
    arrays["volume"] = np.array(item.volume)
    arrays["part_vertices"] = np.concatenate(item.parts)
    arrays["part_sizes"] = np.array([len(part) for part in item.parts])
    write_whole(path, lambda file: np.savez(file, allow_pickle=False, **arrays))


def load(path: Path) -> GraspObject:
    """The object that `save` wrote; raises on a damaged file."""
    _check_sizes(path)
    with np.load(path, allow_pickle=False) as file:
        stored = {name: file[name] for name in file.files}
    parts = np.split(stored["part_vertices"], np.cumsum(stored["part_sizes"])[:-1])
    arrays = {name: stored[name] for name in _ARRAYS}
    if content_hash((*arrays.values(), *parts)) != str(stored["content_hash"]):
        raise ValueError("its arrays are not those that were written")
    return GraspObject(
        name=str(stored["name"]),
        family=str(stored["family"]),
        parts=tuple(parts),
        volume=float(stored["volume"]),
        licence=str(stored["licence"]),
        content_hash=str(stored["content_hash"]),
        **arrays,
    )


def _check_sizes(path: Path) -> None:
    """Refuse arrays that claim more bytes than the file has, before there is room made for them."""
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            if entry.compress_type != zipfile.ZIP_STORED:
                raise ValueError(f"{entry.filename} is compressed")
            with archive.open(entry) as stream:
                shape, _, dtype = read[np.lib.format.read_magic(stream)](stream)
                if stream.tell() + math.prod(shape) * dtype.itemsize != entry.file_size:
                    raise ValueError(f"{entry.filename} has another size than its array")
