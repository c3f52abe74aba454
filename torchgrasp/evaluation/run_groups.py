"""Run directories by label, as `runs=` of recipes/curves.py and recipes/compare.py names them."""

from __future__ import annotations

import glob
from collections.abc import Mapping
from pathlib import Path

from torchgrasp.errors import ConfigError
from torchgrasp.runs.sweep_record import SweepJob, group_jobs, read_sweep

# A run directory, the folder of a sweep or a pattern of either, or several of them.
Runs = str | list[str] | tuple[str, ...]


def find_groups(runs: Runs | Mapping[str, Runs], *, label: str, holding: str) -> dict[str, list[Path]]:
    """Run directories by label, each once, in the order given.

    Args:
        runs: a run directory, the folder of a sweep, a pattern of either or a list of these; a mapping of
            labels to any of them. A sweep's folder alone has a label for each choice of options but the seed.
        label: of runs that are given without one.
        holding: a file that a directory holds where a pattern means it: other recipes' may lie beside.
    """
    if isinstance(runs, Mapping):
        return {str(name): _find(str(name), group, holding) for name, group in runs.items()}
    jobs = read_sweep(runs) if isinstance(runs, str) and Path(runs).is_dir() else []
    if not jobs:
        return {label: _find(label, runs, holding)}
    groups = {name: _runs_of(group) for name, group in group_jobs(jobs).items()}
    if not any(groups.values()):
        raise ConfigError(f"runs={runs}: none of the sweep's jobs has a run directory.")
    return {name: group for name, group in groups.items() if group}


def _find(label: str, group: Runs, holding: str) -> list[Path]:
    patterns = [str(each) for each in (group if isinstance(group, list | tuple) else [group])]
    found: dict[Path, Path] = {}
    for pattern in patterns:
        matches = [run for each in sorted(glob.glob(pattern)) for run in _runs_at(Path(each))]
        if glob.has_magic(pattern):
            matches = [run for run in matches if (run / holding).is_file()]
        if not matches:
            raise ConfigError(f"runs={pattern} ({label}): no run directory with {holding} is there.")
        found |= {run.resolve(): run for run in matches}
    return list(found.values())


def _runs_at(path: Path) -> list[Path]:
    """The runs of a sweep's folder; any other path itself."""
    jobs = read_sweep(path)
    return _runs_of(jobs) if jobs else [path]


def _runs_of(jobs: list[SweepJob]) -> list[Path]:
    """The jobs' run directories; a job without one is named."""
    for job in jobs:
        if job.run_dir is None:
            print(f"Left out: job {job.number} ({job.words}) has no run: {job.failure or 'unfinished'}")
    return [job.run_dir for job in jobs if job.run_dir is not None]
