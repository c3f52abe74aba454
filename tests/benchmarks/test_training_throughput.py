"""The suite `training` measures td3_bc's own loop."""

import benchmark
import pytest
from training_throughput import benchmark_training

from torchgrasp.errors import ConfigError


@pytest.mark.slow
def test_rows_hold_what_the_loop_wrote(composed, capsys):
    options = ['training.overrides=["experiment=smoke"]', "training.workers=[0,1]", "training.iterations=2"]
    rows = benchmark_training(composed(*options))
    assert list(rows) == ["0", "1", "1, overlapping"]
    for row in rows.values():
        # An iteration has 2 episodes of 6 steps and 3 updates.
        assert row["env_steps_per_second_of_both"] * row["iteration_seconds"] == pytest.approx(12)
        seconds = 12 / row["env_steps_per_second"] + 3 / row["updates_per_second"]
        assert 0 < seconds <= row["iteration_seconds"] * 1.001
    assert "x 1.00" in capsys.readouterr().out


@pytest.mark.parametrize("workers", ["[]", "[-1]", "[two]"])
def test_workers_that_cannot_be_are_refused(composed, workers):
    with pytest.raises(ConfigError, match=r"training\.workers"):
        benchmark.benchmark(composed("suite=training", f"training.workers={workers}"))
