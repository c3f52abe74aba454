"""Checkpoints: a folder of safetensors and JSON, whole or not there, checked when it is read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torchgrasp
from torchgrasp.data.files import check_file, describe_file, find_folder, replace_folder
from torchgrasp.data.state_files import read_state, write_state
from torchgrasp.errors import CheckpointError

_MANIFEST = "manifest.json"
# 2: what a learner, its run and its buffer hold stand in entries of their own.
_FORMAT = 2
_MAX_READS = 20
_REMEDY = "restore the folder from a copy, or begin another run"


def save_checkpoint(path: str | Path, state: Mapping[str, Any]) -> None:
    """Write `state` to the folder `path`, replacing the checkpoint there only once all is on disk.

    Each entry becomes files of `write_state`, which tells what an entry may hold. `manifest.json`
    keeps size and CRC-32 of every file.
    """
    with replace_folder(path) as folder:
        for name, value in state.items():
            if not name.replace("_", "").replace("-", "").isalnum():
                raise CheckpointError(
                    f"{name!r} names an entry of a checkpoint: use letters, digits, _ and -."
                )
            write_state(folder, name, value)
        files = {file.name: describe_file(file) for file in sorted(folder.iterdir())}
        manifest = {"format": _FORMAT, "torchgrasp": torchgrasp.__version__, "entries": list(state)}
        (folder / _MANIFEST).write_text(json.dumps({**manifest, "files": files}, indent=2))


def load_checkpoint(path: str | Path) -> dict[str, Any]:
    """Read what `save_checkpoint` wrote, tensors on the CPU; CheckpointError says what is wrong with it.

    A run may replace the checkpoint meanwhile: what is read is one of the two, whole.
    """
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
    for name, expected in manifest["files"].items():
        check_file(folder / name, expected, _REMEDY)
    return {name: read_state(folder, name, _REMEDY) for name in manifest["entries"]}


def has_checkpoint(path: str | Path) -> bool:
    """Whether a complete checkpoint lies at the folder `path`."""
    return (find_folder(path) / _MANIFEST).is_file()


def checkpoint_exists(run_dir: str | Path | None) -> bool:
    """Whether there is a checkpoint in a run directory, whole or damaged: such a run does not begin anew."""
    return run_dir is not None and find_folder(Path(run_dir) / "checkpoint").exists()


def check_format(path: str | Path) -> None:
    """Refuse the checkpoint at the folder `path` that another version wrote, or whose manifest is damaged."""
    _read_manifest(find_folder(path))


def _read_manifest(folder: Path) -> dict[str, Any]:
    file = folder / _MANIFEST
    try:
        manifest = json.loads(file.read_text())
        version, _, _ = manifest["format"], dict(manifest["files"]), list(manifest["entries"])
    except OSError as error:
        message = f"There is no checkpoint at {folder} (no {_MANIFEST}): name a run directory's."
        raise CheckpointError(message) from error
    except (ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{file} is damaged ({error}): {_REMEDY}.") from error
    if version != _FORMAT:
        raise CheckpointError(
            f"{file} has format {version}, this version reads {_FORMAT}: go on with the torchgrasp that "
            "wrote it, or begin a new run with init=<its run directory>."
        )
    return manifest
