"""Checkpoints: a folder of safetensors and JSON, whole or not there, checked when it is read."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

import torchgrasp
from torchgrasp.data.files import FileRecord, check_file, describe_file, find_folder, replace_folder
from torchgrasp.data.state_files import read_state, write_state
from torchgrasp.documents import Document, Name, check_document, read_json, reading, shorten
from torchgrasp.errors import CheckpointError
from torchgrasp.runs.state_likeness import find_unlike

_MANIFEST = "manifest.json"
# 2: what a learner, its run and its buffer hold stand in entries of their own.
_FORMAT = 3
_MAX_READS = 20
_REMEDY = "restore the folder from a copy, or begin another run"
_NAME = r"^[\w-]{1,200}$"


class Manifest(Document):
    """manifest.json: what a checkpoint holds, in files `<entry>.json` and, where there are tensors, more."""

    format: Literal[3]
    torchgrasp: Name
    entries: list[Annotated[str, Field(pattern=_NAME)]]
    files: dict[str, FileRecord]

    @model_validator(mode="after")
    def _check_files(self) -> Manifest:
        needed = {f"{name}.json" for name in self.entries}
        allowed = needed | {f"{name}.safetensors" for name in self.entries}
        if len(needed) < len(self.entries) or not needed <= self.files.keys() <= allowed:
            raise ValueError("files of the entries, and no others")
        return self


def save_checkpoint(path: str | Path, state: Mapping[str, Any]) -> None:
    """Write `state` to the folder `path`, replacing the checkpoint there only once all is on disk.

    Each entry becomes files of `write_state`, which tells what an entry may hold. `manifest.json`
    keeps size and CRC-32 of every file.
    """
    with replace_folder(path) as folder:
        for name, value in state.items():
            if not re.match(_NAME, name):
                raise CheckpointError(
                    f"{name!r} names an entry of a checkpoint: use letters, digits, _ and -."
                )
            write_state(folder, name, value)
        files = {file.name: describe_file(file) for file in sorted(folder.iterdir())}
        manifest = {"format": _FORMAT, "torchgrasp": torchgrasp.__version__, "entries": list(state)}
        manifest = check_document({**manifest, "files": files}, Manifest, folder / _MANIFEST, _REMEDY)
        (folder / _MANIFEST).write_text(json.dumps(manifest.model_dump(), indent=2))


def load_checkpoint(path: str | Path, *, like: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Read what `save_checkpoint` wrote, tensors on the CPU; CheckpointError says what is wrong with it.

    A run may replace the checkpoint meanwhile: what is read is one of the two, whole.

    Args:
        path: the folder.
        like: the state that is to be replaced, in the form in which it would be saved; what is read must
            have the same kinds of values, see `find_unlike`. Not compared if None.
    """
    with reading(Path(path), _REMEDY):
        Path(path).exists()
    state = _load_latest(path)
    unlike = None if like is None else find_unlike(state, dict(like))
    if unlike is not None:
        raise CheckpointError(
            f"{path} is of another configuration, or damaged ({unlike}): resume the run as it was begun, or "
            f"{_REMEDY}."
        )
    return state


def load_entry(path: str | Path, name: str) -> Any:
    """One entry of the checkpoint at the folder `path`, which nobody replaces meanwhile."""
    folder = find_folder(path)
    manifest = _read_manifest(folder)
    for file in (f"{name}.json", f"{name}.safetensors"):
        if file in manifest.files:
            check_file(folder / file, manifest.files[file], _REMEDY)
    if name not in manifest.entries:
        raise CheckpointError(f"{path} has no {name}: {_REMEDY}.")
    return read_state(folder, name, _REMEDY)


def _load_latest(path: str | Path) -> dict[str, Any]:
    error = CheckpointError(f"{path} is replaced faster than it can be read: pause the run that writes it.")
    for _ in range(_MAX_READS):
        folder = find_folder(path)
        before = _identify(folder)
        try:
            state = _load_folder(folder)
        except CheckpointError as damage:
            error = damage
            # The same folder under the same name: nobody replaced it, so the damage is real.
            if before is not None and find_folder(path) == folder and _identify(folder) == before:
                break
            continue
        if _identify(folder) == before:
            return state
    raise error


def _identify(folder: Path) -> tuple[int, int] | None:
    try:
        status = folder.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns


def _load_folder(folder: Path) -> dict[str, Any]:
    manifest = _read_manifest(folder)
    for name, expected in manifest.files.items():
        check_file(folder / name, expected, _REMEDY)
    for name in manifest.entries:
        file = f"{name}.safetensors"
        if file not in manifest.files and (folder / file).exists():
            raise CheckpointError(f"{folder / file} is no part of the checkpoint beside it: {_REMEDY}.")
    return {name: read_state(folder, name, _REMEDY) for name in manifest.entries}


def checkpoint_exists(run_dir: str | Path | None) -> bool:
    """Whether there is a checkpoint in a run directory, whole or damaged: such a run does not begin anew."""
    return run_dir is not None and find_folder(Path(run_dir) / "checkpoint").exists()


def check_format(path: str | Path) -> None:
    """Refuse the checkpoint at the folder `path` that another version wrote, or whose manifest is damaged."""
    _read_manifest(find_folder(path))


def _read_manifest(folder: Path) -> Manifest:
    file = folder / _MANIFEST
    with reading(file, _REMEDY):
        there = file.exists()
    if not there:
        raise CheckpointError(f"There is no checkpoint at {folder} (no {_MANIFEST}): name a run directory's.")
    manifest = read_json(file, _REMEDY)
    version = manifest.get("format", _FORMAT) if isinstance(manifest, dict) else _FORMAT
    if version != _FORMAT:
        raise CheckpointError(
            f"{file} has format {shorten(version)}, this version reads {_FORMAT}: go on with the torchgrasp "
            "that wrote it, or begin a new run with init=<its run directory>."
        )
    return check_document(manifest, Manifest, file, _REMEDY)
