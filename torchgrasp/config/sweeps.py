"""Sweeps through Hydra's launchers: what conf/sweep.yaml calls around the jobs of `-m`."""

from __future__ import annotations

import functools
import multiprocessing
import sys
import traceback
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import psutil
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from torchgrasp.config.one_line_errors import JobInterruptedError, find_cause
from torchgrasp.data.files import try_folder
from torchgrasp.errors import StorageError
from torchgrasp.interruption import (
    Interrupted,
    check,
    hold,
    is_interrupted,
    watch_signals,
)
from torchgrasp.names import one_line
from torchgrasp.processes import end_with_parent
from torchgrasp.runs.sweep_record import SweepJob, note_run_dir, read_job, read_sweep, write_job

# Signals are put off from a sweep's start to its end, but for what a job itself lets through.
_watch = ExitStack()


class SweepRecord(Callback):
    """Keeps the record of a sweep; a job that fails is named and the others go on.

    Jobs write their own files, because a launcher may run them in other processes. At ctrl-C or SIGTERM each
    job that runs ends in good order, and no further one begins.
    """

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Make the sweep's folder, and put signals off until its end."""
        try:
            try_folder(config.hydra.sweep.dir)
        except StorageError as error:
            print(f"error: {error}", file=sys.stderr, flush=True)
            raise SystemExit(1) from None
        in_processes = "joblib" in str(config.hydra.launcher._target_)
        _watch.enter_context(watch_signals(tell=_tell_jobs if in_processes else None))
        _watch.enter_context(hold())

    def on_job_start(self, config: DictConfig, **_: Any) -> None:
        """Begin the job's file."""
        if (place := _place(config)) is not None:
            if multiprocessing.parent_process() is not None:
                _begin_in_child()
            job = SweepJob(place[1], tuple(config.hydra.overrides.task))
            if not is_interrupted():
                print(f"\nJob {job.number}: {job.words}", flush=True)
            write_job(place[0], job)

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **_: Any) -> None:
        """Complete the job's file."""
        if (place := _place(config)) is None:
            return
        job, failure = read_job(*place), None
        if job_return.status == JobStatus.FAILED:
            error: Any = job_return._return_value
            failure = _describe(error)
            if not isinstance(error, JobInterruptedError):
                print(f"error: job {job.number} ({job.words}): {failure}", file=sys.stderr, flush=True)
            # Hydra's sweeper would raise it again after the last job, with a traceback and without our end.
            job_return.status, job_return.return_value = JobStatus.COMPLETED, None
        write_job(place[0], SweepJob(job.number, job.overrides, job.run_dir, failure, ended=failure is None))

    def on_multirun_end(self, config: DictConfig, **_: Any) -> None:
        """Tell how to compare the runs, and name the jobs that failed; exit code 1 if any did."""
        folder = Path(config.hydra.sweep.dir)
        jobs = read_sweep(folder)
        bad = [job for job in jobs if not job.ended]
        print(f"\n{len(jobs) - len(bad)} of {len(jobs)} jobs finished")
        for job in bad:
            where = "" if job.run_dir is None else f" (go on with resume={job.run_dir})"
            print(f"  job {job.number} failed: {job.words}: {job.failure or 'it was killed'}{where}")
        if any(job.run_dir is not None for job in jobs if job.ended):
            print(f"Compare them: torchgrasp compare runs={folder}", flush=True)
        code = 1 if bad else 0
        with _watch:
            try:
                check()
            except Interrupted as interruption:
                code = interruption.exit_code
        if code:
            raise SystemExit(code)


def note_run(run_dir: Path) -> None:
    """In a job of a sweep, note the directory that it writes to."""
    config: Any = HydraConfig.instance().cfg
    place = _place(config)
    if place is not None:
        note_run_dir(*place, run_dir)


@functools.cache
def _begin_in_child() -> None:
    """Once in each process of a launcher: it ends with its parent, and puts signals off between jobs."""
    if multiprocessing.get_start_method() not in multiprocessing.get_all_start_methods():
        # joblib's processes were started in a way of its own, which ours would ask for in vain.
        multiprocessing.set_start_method("spawn", force=True)
    end_with_parent()
    _watch.enter_context(watch_signals())
    _watch.enter_context(hold())


def _tell_jobs() -> None:
    """Hand a signal on: a scheduler may have told this process alone. SIGTERM may come twice."""
    for child in psutil.Process().children():
        with suppress(psutil.Error):
            child.terminate()


def _place(config: DictConfig | None) -> tuple[Path, int] | None:
    """A job's sweep folder and number; None outside sweeps, and where conf/sweep.yaml is not included."""
    if config is None or config.hydra.mode != RunMode.MULTIRUN or "sweep" not in config.hydra.callbacks:
        return None
    return Path(config.hydra.sweep.dir), int(config.hydra.job.num)


def _describe(error: Any) -> str:
    """One line for a user's error; any other one's traceback is printed as well."""
    cause = find_cause(error)
    if cause is None:
        traceback.print_exception(error)
        return one_line(f"{type(error).__name__}: {error}")
    return one_line(cause)
