"""Files and folders that are either whole or not there, whenever the process is killed, and checksums."""

from __future__ import annotations

import json
import os
import shutil
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torchgrasp.errors import CheckpointError, DamageError

# Ends the text of a sealed JSON file; its own checksum follows.
_SEAL = ',\n  "crc32": '


def write_text_atomically(path: str | Path, text: str) -> None:
    """Write `text` to `path`: a reader sees the old content or the new one, never a part."""
    path = Path(path)
    part = path.with_name(f".{path.name}.new")
    # Names may hold bytes of no encoding, which stay legible so.
    part.write_text(text, encoding="utf-8", errors="backslashreplace")
    _fsync(part)
    part.replace(path)
    _fsync(path.parent)


def write_json_atomically(path: str | Path, value: Any) -> None:
    """Write `value` as indented JSON; see `write_text_atomically`."""
    write_text_atomically(path, json.dumps(value, indent=2) + "\n")


def seal_json(value: Mapping[str, Any]) -> str:
    """Indented JSON of a filled mapping, whose last entry `crc32` guards every byte before it."""
    body = json.dumps(dict(value), indent=2).removesuffix("\n}")
    return f"{body}{_SEAL}{zlib.crc32(body.encode())}\n}}\n"


def read_sealed_json(path: str | Path, remedy: str) -> dict[str, Any]:
    """Read what `seal_json` gave, without `crc32`; DamageError names a missing or changed file."""
    try:
        body, _, tail = _read_bytes(Path(path), remedy).decode().rpartition(_SEAL)
        if tail != f"{zlib.crc32(body.encode())}\n}}\n":
            raise ValueError("its checksum differs")
        return json.loads(body + "\n}")
    except ValueError as error:
        raise DamageError(
            f"{path} was changed or cut short after it was saved ({error}): {remedy}."
        ) from error


def _read_bytes(path: Path, remedy: str) -> bytes:
    with reading(path, remedy):
        return path.read_bytes()


@contextmanager
def reading(path: Path, remedy: str) -> Iterator[None]:
    """Tell what is missing from what only cannot be read now: rights, open files, a disk's fault."""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise DamageError(f"{path} is missing: {remedy}.") from error
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be read ({error.strerror}), which does not mean that it is damaged: mend that, "
            "then try again."
        ) from error


def describe_file(file: Path) -> dict[str, int]:
    """Size in bytes and CRC-32 of a file, which is read in pieces."""
    checksum = 0
    with file.open("rb") as stream:
        while block := stream.read(1 << 22):
            checksum = zlib.crc32(block, checksum)
    return {"bytes": file.stat().st_size, "crc32": checksum}


def check_file(file: Path, expected: Mapping[str, int], remedy: str, *, checksum: bool = True) -> None:
    """Raise DamageError unless `file` is as `describe_file` told; without `checksum`, of that size."""
    with reading(file, remedy):
        size = file.stat().st_size
        same = size == expected["bytes"] and (not checksum or describe_file(file) == dict(expected))
    if size != expected["bytes"]:
        raise DamageError(f"{file} has {size} bytes instead of {expected['bytes']}: {remedy}.")
    if not same:
        raise DamageError(f"{file} was changed after it was saved (its checksum differs): {remedy}.")


@contextmanager
def replace_folder(path: str | Path) -> Iterator[Path]:
    """Yield an empty folder beside `path` that takes its place once the block has ended well.

    The folder that was at `path` stays readable through `find_folder` until the new one is on disk
    in full. One process may write to a path at a time.
    """
    path = Path(path).absolute()
    new, old = path.with_name(f".{path.name}.new"), _old(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir()
    try:
        yield new
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    fsync_tree(new)
    if path.exists():
        shutil.rmtree(old, ignore_errors=True)
        path.rename(old)
    new.rename(path)
    _fsync(path.parent)
    shutil.rmtree(old, ignore_errors=True)


def find_folder(path: str | Path) -> Path:
    """`path`, or where a replacement that was killed between its two renames has left the old one."""
    path = Path(path).absolute()
    return _old(path) if not path.exists() and _old(path).exists() else path


def _old(path: Path) -> Path:
    return path.with_name(f".{path.name}.old")


def fsync_tree(folder: Path) -> None:
    """Wait until the folder's files, and the names of them, are on disk."""
    for file in folder.rglob("*"):
        _fsync(file)
    _fsync(folder)


def _fsync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
