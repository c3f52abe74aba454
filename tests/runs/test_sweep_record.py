import shutil

import pytest

from torchgrasp.errors import CheckpointError
from torchgrasp.runs.sweep_record import (
    SweepJob,
    group_jobs,
    note_run_dir,
    read_failure,
    read_job,
    read_sweep,
    write_job,
)


def test_jobs_come_back_in_order_with_their_runs(tmp_path):
    folder, run = tmp_path / "sweeps" / "first", tmp_path / "td3_bc" / "run"
    for number in (10, 2, 0):
        write_job(folder, SweepJob(number, (f"seed={number}",)))
    note_run_dir(folder, 2, run)
    assert [job.number for job in read_sweep(folder)] == [0, 2, 10]
    assert [job.run_dir for job in read_sweep(folder)] == [None, run, None]
    assert read_sweep(tmp_path) == []


def test_outputs_may_be_moved_as_a_whole(tmp_path, monkeypatch):
    run = tmp_path / "outputs" / "td3_bc" / "run"
    write_job(tmp_path / "outputs" / "sweeps" / "first", SweepJob(0, (), run, ended=True))
    shutil.move(tmp_path / "outputs", tmp_path / "moved")
    (job,) = read_sweep(tmp_path / "moved" / "sweeps" / "first")
    assert job.run_dir == tmp_path / "moved" / "td3_bc" / "run"
    monkeypatch.chdir(tmp_path)
    assert str(read_job("moved/sweeps/first", 0).run_dir) == "moved/td3_bc/run"


def test_a_failure_is_noted_where_the_run_is_until_it_finishes(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    assert read_failure(run) is None
    write_job(tmp_path / "sweep", SweepJob(0, (), run, failure="out of memory"))
    assert read_failure(run) == "out of memory"
    (run / "summary.json").write_text("{}")  # resumed, and now whole
    assert read_failure(run) is None


def test_groups_differ_in_what_was_swept():
    def jobs(*overrides):
        return [SweepJob(number, each) for number, each in enumerate(overrides)]

    seeds = jobs(("seed=0", "a=1"), ("seed=1", "a=1"))
    assert {label: len(group) for label, group in group_jobs(seeds).items()} == {"all runs": 2}
    two = jobs(("a=1", "b=[x,y]"), ("a=1", "b=z"), ("a=2", "b=z"))
    assert list(group_jobs(two)) == ["a=1, b=[x,y]", "a=1, b=z", "a=2, b=z"]
    assert group_jobs([]) == {}


def test_a_damaged_record_is_named(tmp_path):
    (tmp_path / "job_0.json").write_text("{")
    with pytest.raises(CheckpointError, match=r"job_0\.json"):
        read_sweep(tmp_path)
