"""The benchmark of experts, on a few scenes."""

import json

import benchmark
import pytest

from torchgrasp.errors import ConfigError

SMALL = ["suite=planner", "episodes=2", "env.num_envs=2", "scenes=3"]
SMALL += ["objects.num_objects=2", "objects.num_grasps=100"]


@pytest.mark.slow
def test_experts_are_measured_on_the_same_scenes(run_benchmark, tmp_path):
    code, out, err = run_benchmark(*SMALL, "experts=[straight,trajectory]")
    assert code == 0, err
    assert out.count("neighbours: actions differ") == 2
    (written,) = tmp_path.glob("benchmark/*/benchmark.json")
    rows = json.loads(written.read_text())["rows"]
    assert list(rows) == ["straight", "trajectory"]
    for row in rows.values():
        assert 0 < row["plan_median_milliseconds"] <= row["plan_p95_milliseconds"]
        assert row["label_milliseconds"] > 0 and row["label_off_path_milliseconds"] > 0
        assert row["episodes"] == 2 and sum(row["plan_statuses"].values()) == 3
        assert row["neighbour_ratio_median"] >= 0 and 0 <= row["neighbour_other_goal"] <= 1


@pytest.mark.parametrize("experts", ["nobody", "[nobody]"])
def test_unknown_experts_are_refused(composed, experts):
    cfg = composed(*SMALL, f"experts={experts}")
    with pytest.raises(ConfigError, match="trajectory_funnel"):
        benchmark.benchmark(cfg)
