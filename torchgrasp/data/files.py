"""Files and folders that are either whole or not there, whenever the process is killed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def write_text_atomically(path: str | Path, text: str) -> None:
    """Write `text` to `path`: a reader sees the old content or the new one, never a part."""
    path = Path(path)
    part = path.with_name(f".{path.name}.new")
    part.write_text(text)
    _fsync(part)
    part.replace(path)
    _fsync(path.parent)


def write_json_atomically(path: str | Path, value: Any) -> None:
    """Write `value` as indented JSON; see `write_text_atomically`."""
    write_text_atomically(path, json.dumps(value, indent=2) + "\n")


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
