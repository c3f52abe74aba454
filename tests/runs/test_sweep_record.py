import json
import shutil

import pytest

from tests.hostile_values import check_each, check_texts
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


def test_hostile_records_are_refused(tmp_path):
    (tmp_path / "run").mkdir()
    write_job(tmp_path, SweepJob(0, ("seed=0",), tmp_path / "run", failure="out of memory"))
    file = tmp_path / "job_0.json"
    record = json.loads(file.read_text())

    def write(document):
        file.write_text(json.dumps(document))

    def free(words):  # that it has no run yet, or no failure
        return words in ("run_dir: null", "failure: null", "overrides: list", "overrides.0: left out")

    assert check_each(record, write, lambda: read_sweep(tmp_path), free=free) > 40
    for name in ("/etc", "a" * 5000, "run\0"):
        write({**record, "run_dir": name})
        with pytest.raises(CheckpointError, match=r"job_0\.json cannot be used"):
            read_sweep(tmp_path)
    check_texts(file, lambda: read_sweep(tmp_path))


def test_files_of_other_names_are_no_jobs(tmp_path):
    write_job(tmp_path, SweepJob(0, ("seed=0",)))
    (tmp_path / "job_one.json").write_text("{")
    assert [job.number for job in read_sweep(tmp_path)] == [0]


def test_what_a_failure_hides_from_the_eye_is_escaped(tmp_path):
    write_job(tmp_path, SweepJob(0, (), failure="no mesh \x1b[2J\udcff.stl"))
    assert read_job(tmp_path, 0).failure == r"no mesh \x1b[2J\udcff.stl"
