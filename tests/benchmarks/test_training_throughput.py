"""The suite `training` measures td3_bc's own loop."""

import benchmark
import pytest
from training_throughput import _list_variants, benchmark_training
from who_waits import tell_who_waits

from torchgrasp.errors import ConfigError


@pytest.mark.slow
def test_rows_hold_what_the_loop_wrote(composed, capsys):
    options = ['training.overrides=["experiment=smoke"]', "training.workers=[0,1]", "training.iterations=2"]
    rows = benchmark_training(composed(*options))
    assert list(rows) == ["serial", "pool 1", "pool 1, overlapping"]
    for row in rows.values():
        # An iteration has 2 episodes of 6 steps and 3 updates.
        assert row["env_steps_per_second_of_both"] * row["iteration_seconds"] == pytest.approx(12)
        seconds = 12 / row["env_steps_per_second"] + 3 / row["updates_per_second"]
        assert 0 < seconds <= row["iteration_seconds"] * 1.001
        assert 0 < row["learner_waits_seconds"] < row["iteration_seconds"]
        assert 0 <= row["worker_waits_seconds"] < row["iteration_seconds"]
        assert row["env_step_milliseconds"] > 0 and row["update_milliseconds"] > 0
        assert 6 * 32 * 4 * 4 < row["episode_bytes"] < row["policy_bytes"]  # at least the steps' points
    out = capsys.readouterr().out
    assert "An episode has " in out and "x 1.00" in out and "pool 1, overlapping: " in out.splitlines()[-1]


@pytest.mark.parametrize(
    ("waits", "workers", "groups", "told"),
    [
        ((3.1, 0.2), 2, 14, "the learner waits 3.1 of 9.2 s an iteration for rollouts; more workers help"),
        ((3.1, 0.2), 14, 14, "more workers help with more groups of worlds"),
        ((3.1, 0.2), 15, 2, "more groups of worlds help"),
        (
            (0.4, 5.0),
            2,
            14,
            "a worker waits 5.0 of 9.2 s an iteration for the learner; more workers bring nothing",
        ),
        ((0.4, 0.5), 2, 14, "neither side waits"),
    ],
)
def test_a_sentence_tells_who_waits_and_what_helps(waits, workers, groups, told):
    row = {"workers": workers, "iteration_seconds": 9.2}
    row |= dict(zip(("learner_waits_seconds", "worker_waits_seconds"), waits, strict=True))
    assert told in tell_who_waits(row, groups)


def test_every_collector_has_rows_and_no_workers_are_serial(composed):
    cfg = composed("training.workers=[0,2]", "training.collectors=[pool,ray]")
    names = [name for name, _ in _list_variants(cfg)]
    assert names == ["serial", "pool 2", "pool 2, overlapping", "ray 2", "ray 2, overlapping"]


def test_collectors_that_cannot_be_are_refused(composed):
    with pytest.raises(ConfigError, match=r"training\.collectors"):
        benchmark.benchmark(composed("suite=training", "training.collectors=[cluster]"))


@pytest.mark.parametrize("workers", ["[]", "[-1]", "[two]"])
def test_workers_that_cannot_be_are_refused(composed, workers):
    with pytest.raises(ConfigError, match=r"training\.workers"):
        benchmark.benchmark(composed("suite=training", f"training.workers={workers}"))
