"""Files and folders that are either whole or not there, whenever the process is killed, and checksums.

What cannot be written is a StorageError, which names it and says what to do.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import stat
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from safetensors import SafetensorError

from torchgrasp.documents import Count, Crc32, Document, parse_json, read_text, reading, shorten
from torchgrasp.errors import DamageError, StorageError

# Ends the text of a sealed JSON file; its own checksum follows.
_SEAL = ',\n  "crc32": '
# Ends other sealed text, as a comment of YAML.
_COMMENT = "# crc32 "
# What is missing where a file cannot be written, by the system's number for it.
_REMEDIES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "make room there, then go on"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "give a folder that can be written"),
    **dict.fromkeys((errno.ENOTDIR, errno.EEXIST, errno.EISDIR), "a file stands in its way, give another"),
}


class FileRecord(Document):
    """What a file's bytes are known by."""

    bytes: Count
    crc32: Crc32


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Turn what keeps the block from writing to `path` into a StorageError; what was there stays whole."""
    try:
        yield
    except (OSError, SafetensorError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        remedy = _REMEDIES.get(_number(error), "mend that, or give another folder")
        raise StorageError(f"{path} cannot be written ({reason}): {remedy}.") from error


def _number(error: OSError | SafetensorError) -> int:
    """The system's number of an error, which safetensors tells in words alone; 0 where none is told."""
    if isinstance(error, OSError):
        return error.errno or 0
    told = re.search(r"os error (\d+)", str(error))
    return 0 if told is None else int(told[1])


def write_text_atomically(path: str | Path, text: str) -> None:
    """Write `text` to `path` as UTF-8; see `write_bytes_atomically`."""
    # Names may hold bytes of no encoding, which stay legible so.
    write_bytes_atomically(path, text.encode(errors="backslashreplace"))


def write_bytes_atomically(path: str | Path, content: bytes) -> None:
    """Write `content` to `path`: a reader sees the old content or the new one, never a part."""
    path = Path(path)
    part = path.with_name(f".{path.name}.new")
    with writing(path):
        try:
            part.write_bytes(content)
            _fsync(part)
            part.replace(path)
        except OSError:
            with suppress(OSError):
                part.unlink()
            raise
        _fsync(path.parent)


def try_folder(path: str | Path) -> None:
    """Make the folder and write something there, which is deleted: before work whose result goes there."""
    with writing(path):
        Path(path).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path) as file:
            file.write(b"something")


def prove_room(folder: Path, sizes: Iterable[int]) -> None:
    """Raise OSError unless files of these sizes (bytes) fit into the folder beside one another.

    A disk that is full ends a process that writes to a mapped file, without a word.
    """
    if not hasattr(os, "posix_fallocate"):  # as on macOS
        return
    with tempfile.TemporaryDirectory(dir=folder, prefix=".room") as room:
        for number, size in enumerate(sizes):
            with Path(room, str(number)).open("wb") as file:
                if size:
                    os.posix_fallocate(file.fileno(), 0, size)


def write_json_atomically(path: str | Path, value: Any) -> None:
    """Write `value` as indented JSON; see `write_text_atomically`."""
    write_text_atomically(path, json.dumps(value, indent=2) + "\n")


def seal_json(value: Mapping[str, Any]) -> str:
    """Indented JSON of a filled mapping, whose last entry `crc32` guards every byte before it."""
    body = json.dumps(dict(value), indent=2).removesuffix("\n}")
    return f"{body}{_SEAL}{zlib.crc32(body.encode())}\n}}\n"


def read_sealed_json(path: str | Path, remedy: str) -> dict[str, Any]:
    """Read what `seal_json` gave, without `crc32`; DamageError names a missing or changed file."""
    body, _, tail = read_text(path, remedy, error=DamageError).rpartition(_SEAL)
    if tail != f"{zlib.crc32(body.encode())}\n}}\n":
        raise _changed(path, remedy)
    value = parse_json(body + "\n}", path, remedy, error=DamageError)
    if not isinstance(value, dict):
        raise DamageError(f"{path} holds {shorten(value)} instead of entries: {remedy}.")
    return value


def seal_text(text: str) -> str:
    """`text`, such as YAML, with a last line that is a comment and guards every byte before it."""
    text = text if text.endswith("\n") else text + "\n"
    return f"{text}{_COMMENT}{zlib.crc32(text.encode())}\n"


def read_sealed_text(path: str | Path, remedy: str) -> str:
    """Read what `seal_text` gave, without its last line; DamageError names a missing or changed file."""
    text, _, tail = read_text(path, remedy, error=DamageError).rpartition(_COMMENT)
    if tail != f"{zlib.crc32(text.encode())}\n":
        raise _changed(path, remedy)
    return text


def _changed(path: str | Path, remedy: str) -> DamageError:
    return DamageError(f"{path} was changed or cut short after it was saved (checksum differs): {remedy}.")


def describe_file(file: Path) -> dict[str, int]:
    """Size in bytes and CRC-32 of a file, which is read in pieces: a `FileRecord` as plain values."""
    checksum = 0
    with file.open("rb") as stream:
        while block := stream.read(1 << 22):
            checksum = zlib.crc32(block, checksum)
    return {"bytes": file.stat().st_size, "crc32": checksum}


def check_file(file: Path, expected: FileRecord, remedy: str, *, checksum: bool = True) -> None:
    """Raise DamageError unless `file` is as `describe_file` told; without `checksum`, of that size."""
    with reading(file, remedy):
        status = file.stat()
        size, regular = status.st_size, stat.S_ISREG(status.st_mode)
        same = regular and size == expected.bytes
        same = same and (not checksum or describe_file(file) == expected.model_dump())
    if not regular:
        raise DamageError(f"{file} is no regular file: {remedy}.")
    if size != expected.bytes:
        raise DamageError(f"{file} has {size} bytes instead of {expected.bytes}: {remedy}.")
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
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        try:
            yield new
            fsync_tree(new)
            if path.exists():
                shutil.rmtree(old, ignore_errors=True)
                path.rename(old)
            new.rename(path)
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
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
