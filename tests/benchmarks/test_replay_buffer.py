"""The benchmark of a full replay buffer, on a small one."""

import json

import benchmark
import pytest

from torchgrasp.errors import ConfigError

SMALL = ["suite=replay", "transitions=5000", "draws=5", "objects.num_objects=1", "objects.num_grasps=100"]


@pytest.mark.parametrize("on_disk", [False, True])
def test_a_buffer_is_filled_drawn_from_saved_and_read_back(composed, tmp_path, on_disk):
    folder = tmp_path / "rows"
    cfg = composed(*SMALL, *([f"replay_folder={folder}"] if on_disk else []))
    row = benchmark.benchmark(cfg)["rows"]["replay"]
    assert row["equal_after_reload"]
    assert row["bytes_per_transition"] == 6276
    # What a checkpoint writes: the rows, not what the sampler can form anew from them.
    assert 5000 * 6200 < row["saved_bytes"] < 5000 * 6276
    for name in ("uniform", "prioritised"):
        assert 0 < row[f"{name}_median_milliseconds"] <= row[f"{name}_p95_milliseconds"]
        assert row[f"{name}_computing_milliseconds"] > 0 and row[f"{name}_update_milliseconds"] > 0
    (written,) = tmp_path.glob("benchmark/*/benchmark.json")
    assert json.loads(written.read_text())["rows"]["replay"] == row
    # Nothing of the rows is left behind.
    assert {path.name for path in tmp_path.iterdir()} == {"benchmark"} | ({"rows"} if on_disk else set())
    assert not on_disk or not list(folder.iterdir())


def test_a_buffer_that_does_not_fit_is_refused_before_it_is_filled(composed):
    cfg = composed(*SMALL, "transitions=1000000000000")
    with pytest.raises(ConfigError, match="would fit"):
        benchmark.benchmark(cfg)
    with pytest.raises(ConfigError, match="transitions=7"):
        benchmark.benchmark(composed(*SMALL, "transitions=7"))
