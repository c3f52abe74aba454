"""A sweep's record: one small file a job, so that runs can be found and compared by what was swept."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torchgrasp.data.files import write_json_atomically, write_text_atomically, writing
from torchgrasp.documents import Document, RelativePath, Text, check_document, read_document, read_text
from torchgrasp.errors import printable

_FAILURE = "failed.txt"
_REMEDY = "restore it from a copy"


class JobRecord(Document):
    """A job's file; `run_dir` is seen from the sweep's folder."""

    overrides: list[Text]
    run_dir: RelativePath | None
    failure: Text | None
    ended: bool


@dataclass(frozen=True)
class SweepJob:
    """One job of a sweep.

    `overrides` are its options as on the command line, `run_dir` its run directory once it has one,
    `failure` why it failed. A job that is still running, or was killed, has neither ended nor failed.

    >>> SweepJob(0, ("seed=0", "loss.bc_weight=0.5")).ended
    False
    """

    number: int
    overrides: tuple[str, ...]
    run_dir: Path | None = None
    failure: str | None = None
    ended: bool = False

    @property
    def words(self) -> str:
        """The job's options in one line."""
        return " ".join(self.overrides) or "(no options)"


def write_job(folder: str | Path, job: SweepJob) -> None:
    """Write or replace a job's file in the sweep's folder; a failure is also noted in the run directory."""
    folder = Path(folder)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    # Relative, so that outputs can be moved or mounted elsewhere as a whole.
    run_dir = None if job.run_dir is None else os.path.relpath(job.run_dir, folder)
    failure = None if job.failure is None else printable(job.failure)
    row = {"overrides": list(job.overrides), "run_dir": run_dir, "failure": failure, "ended": job.ended}
    path = _path(folder, job.number)
    record = check_document(row, JobRecord, path, "give other options, or another output folder")
    write_json_atomically(path, record.model_dump())
    if job.run_dir is not None and job.failure is not None:
        write_text_atomically(job.run_dir / _FAILURE, job.failure + "\n")


def read_job(folder: str | Path, number: int) -> SweepJob:
    """Read one job's file."""
    path = _path(Path(folder), number)
    record = read_document(path, JobRecord, _REMEDY)
    run_dir = None if record.run_dir is None else _shortest(path.parent / record.run_dir)
    return SweepJob(number, tuple(record.overrides), run_dir, record.failure, record.ended)


def read_sweep(folder: str | Path) -> list[SweepJob]:
    """All jobs of a sweep in order; empty where the folder is of no sweep."""
    numbers = [path.stem.removeprefix("job_") for path in Path(folder).glob("job_*.json")]
    return [read_job(folder, number) for number in sorted(int(each) for each in numbers if each.isdecimal())]


def read_failure(run_dir: str | Path) -> str | None:
    """Why a run of a sweep failed, None where it did not, or went on afterwards and finished."""
    path = Path(run_dir) / _FAILURE
    finished = (Path(run_dir) / "summary.json").is_file()
    return read_text(path, _REMEDY).strip() if path.is_file() and not finished else None


def group_jobs(jobs: Sequence[SweepJob]) -> dict[str, list[SweepJob]]:
    """Jobs by what was swept, seeds apart: jobs of one group differ in nothing but their seed.

    >>> jobs = [SweepJob(i, (f"seed={i % 2}", "env.horizon=9", f"lr={i // 2}")) for i in range(4)]
    >>> {label: [job.number for job in group] for label, group in group_jobs(jobs).items()}
    {'lr=0': [0, 1], 'lr=1': [2, 3]}
    """
    options = [[each for each in job.overrides if not each.startswith("seed=")] for job in jobs]
    shared = set(options[0]).intersection(*options) if options else set()
    groups: dict[str, list[SweepJob]] = {}
    for job, own in zip(jobs, options, strict=True):
        label = ", ".join(each for each in own if each not in shared) or "all runs"
        groups.setdefault(label, []).append(job)
    return groups


def note_run_dir(folder: str | Path, number: int, run_dir: Path) -> None:
    """Note where a job writes, as soon as it does."""
    write_job(folder, replace(read_job(folder, number), run_dir=run_dir))


def _path(folder: Path, number: int) -> Path:
    return folder / f"job_{number}.json"


def _shortest(path: Path) -> Path:
    """The path without detours, from the working directory where it lies below it."""
    path = Path(os.path.abspath(path))
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
