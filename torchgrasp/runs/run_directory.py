"""Run directories, and what a summary says of the machine and the versions behind a number."""

from __future__ import annotations

import errno
import platform
import shutil
from collections.abc import Mapping
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any
from uuid import uuid4

import psutil
import torch

from torchgrasp.data.files import fsync_tree, write_json_atomically, writing
from torchgrasp.documents import check_document
from torchgrasp.errors import ConfigError
from torchgrasp.processes import count_cores
from torchgrasp.runs.summary import Summary
from torchgrasp.versions import versions


def make_run_dir(
    recipe: str, *, root: str | Path = "outputs", files: Mapping[str, str] | None = None
) -> Path:
    """Make and return `<root>/<recipe>/<date_time>`, with a number behind where that exists.

    It appears with its first `files` {name: text} in it: no run directory is without its configuration.
    """
    parent = Path(root) / recipe
    with writing(parent):
        parent.mkdir(parents=True, exist_ok=True)
        new = parent / f".{uuid4().hex}.new"
        try:
            new.mkdir()
            for name, text in (files or {}).items():
                (new / name).write_bytes(text.encode())
            fsync_tree(new)
            return _rename_to_free(new, datetime.now().strftime("%Y-%m-%d_%H-%M-%S"))
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise


def _rename_to_free(folder: Path, name: str) -> Path:
    """Give the folder that name, with a number behind where another one has it."""
    for attempt in count():
        path = folder.with_name(name if attempt == 0 else f"{name}_{attempt}")
        if path.exists():  # another run began in the same second
            continue
        try:
            return folder.rename(path)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):  # of one that began just now
                raise
    raise AssertionError("unreachable")


def hardware() -> dict[str, Any]:
    """The machine: processor, cores this process may use, memory (bytes), accelerators, system."""
    names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    return {
        "processor": _processor(),
        "cores": count_cores(),
        "memory_bytes": psutil.virtual_memory().total,
        "accelerators": names,
        "system": f"{platform.system()} {platform.release()}",
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def write_summary(run_dir: str | Path, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Write `<run_dir>/summary.json`, versions and hardware filled in, and return what was written.

    `summary` gives at least success_rate, success_ci95 [low, high], episodes, objects {name:
    {episodes, successes}} (SuccessTable.summary() has these four), wall_seconds, env_steps and
    gradient_steps.
    """
    whole = {"versions": versions(), "hardware": hardware(), **summary}
    check_document(whole, Summary, "The summary", "give plain values for each", error=ConfigError)
    write_json_atomically(Path(run_dir) / "summary.json", whole)
    return whole
