"""The record of a sweep, job by job, as Hydra's callbacks keep it."""

from pathlib import Path

import pytest
from hydra.core.utils import JobReturn, JobStatus
from hydra.types import RunMode
from omegaconf import OmegaConf

from torchgrasp.config.sweeps import SweepRecord, note_run
from torchgrasp.errors import ConfigError
from torchgrasp.runs.sweep_record import note_run_dir, read_sweep


def job_config(folder, number=0):
    hydra = {"mode": RunMode.MULTIRUN, "callbacks": {"sweep": {}}, "sweep": {"dir": str(folder)}}
    return OmegaConf.create(
        {"hydra": {**hydra, "job": {"num": number}, "overrides": {"task": [f"seed={number}"]}}}
    )


def run_job(folder, number, error=None):
    record, config = SweepRecord(), job_config(folder, number)
    record.on_job_start(config)
    run_dir = folder.parent / f"run{number}"
    run_dir.mkdir()
    note_run_dir(folder, number, run_dir)
    done = JobReturn()
    done.status = JobStatus.COMPLETED if error is None else JobStatus.FAILED
    done.return_value = error
    record.on_job_end(config, done)
    return done


def test_jobs_that_end_and_jobs_that_fail_are_told_apart(tmp_path, capsys):
    folder = tmp_path / "sweep"
    run_job(folder, 0)
    failed = run_job(folder, 1, ConfigError("too\nsmall"))
    assert failed.status == JobStatus.COMPLETED and failed.return_value is None  # the others go on
    assert [(job.ended, job.failure) for job in read_sweep(folder)] == [(True, None), (False, "too small")]
    assert "error: job 1 (seed=1): too small" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        SweepRecord().on_multirun_end(job_config(folder))
    told = capsys.readouterr().out
    assert ended.value.code == 1 and "1 of 2 jobs finished" in told
    assert f"resume={tmp_path / 'run1'}" in told and f"Compare them: torchgrasp compare runs={folder}" in told


def test_a_sweep_without_a_failure_ends_well(tmp_path, capsys):
    run_job(tmp_path / "sweep", 0)
    SweepRecord().on_multirun_end(job_config(tmp_path / "sweep"))
    assert "1 of 1 jobs finished" in capsys.readouterr().out


def test_outside_of_a_sweep_nothing_is_noted(composed, tmp_path):
    note_run(tmp_path / "run")
    SweepRecord().on_job_start(OmegaConf.create({"hydra": {"mode": RunMode.RUN, "callbacks": {}}}))
    assert not list(tmp_path.iterdir())


def test_a_sweep_whose_folder_cannot_be_is_refused_in_one_line(capsys):
    with pytest.raises(SystemExit) as ended:
        SweepRecord().on_multirun_start(job_config(Path("/dev/null/x")))
    told = "error: /dev/null/x cannot be written (Not a directory): a file stands in its way, give another.\n"
    assert ended.value.code == 1 and capsys.readouterr().err == told
