"""The suite `env`, on one episode."""

import pytest
from env_speed import benchmark_env, measure_steps

from torchgrasp.errors import ConfigError

SMALL = ["objects.num_objects=1", "objects.num_grasps=100", "env.horizon=5", "collector.num_workers=0"]


def test_parts_of_a_step_add_up_to_its_time(composed):
    row = measure_steps(composed("suite=env", "env.num_envs=2", *SMALL), episodes=1)
    parts = row["milliseconds_per_step"]
    assert {"expert label", "reset", "camera", "physics: steps", "transform AggregatePoints"} <= set(parts)
    own = sum(value for name, value in parts.items() if name != "expert label")
    assert row["steps_per_second"] == pytest.approx(1e3 / own)
    assert row["new_scene_milliseconds"] == pytest.approx(5 * parts["reset"])
    assert 0 < row["ratio_to_physics_only"] < 1


def test_a_peer_that_is_not_there_is_refused_before_anything_is_measured(composed):
    with pytest.raises(ConfigError, match="peer_python=nowhere/python is no program"):
        benchmark_env(composed("peer_python=nowhere/python"))
