"""The suite `scale`, on the smallest sizes, in this process."""

import pytest
import scale
import torch

SMALL = ["scale.experiment=smoke", "scale.overrides=[]", "scale.repeats=1", "scale.rounds=1"]


@pytest.fixture
def here(monkeypatch):
    """Measures in this process, whose memory has been higher before."""
    monkeypatch.setattr(scale, "_measure_alone", scale.measure_update)
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_one_size_at_a_time_grows(composed, here, capsys):
    rows = scale.benchmark_scale(
        composed(*SMALL, "scale.batches=[2]", "scale.points=[8,16]", "scale.workers=[]")
    )
    assert [row["what"] for row in rows] == 3 * ["imitation", "critic", "actor"]
    assert [(row["over"], row["batch"], row["points"]) for row in rows[::3]] == [
        ("batch", 2, 32),
        ("points", 16, 8),
        ("points", 16, 16),
    ]
    assert all(row["milliseconds"] > 0 and row["megabytes"] >= 0 for row in rows)
    assert {(row["device"], row["experiment"]) for row in rows} == {("cpu", "smoke")}
    assert "scale critic      16 x   16 points on cpu" in capsys.readouterr().out


@pytest.mark.slow
def test_workers_are_measured_with_all_that_they_hold(composed, here):
    cfg = composed(*SMALL, "scale.batches=[]", "scale.points=[]", "scale.workers=[1]")
    (row,) = scale.benchmark_scale(cfg)
    assert row["workers"] == 1 and row["env_steps_per_second"] > 0 and row["megabytes"] > 100


def test_workers_are_as_many_as_there_are_cores_for():
    assert scale.choose_workers(None, 4) == [1, 2, 4]
    assert scale.choose_workers([6], 4) == [6]
