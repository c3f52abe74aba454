"""Configurations are refused before anything is measured, and those of conf/ are found beside them."""

import benchmark
import pytest
from composition import compose_config
from hydra.core.global_hydra import GlobalHydra

from torchgrasp.errors import ConfigError


def test_the_values_that_come_along_are_fine(composed):
    cfg = composed()
    assert cfg.camera.intrinsics.width == 112
    benchmark.check_values(cfg, benchmark.Benchmark)


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("suite=everything", "suite='everything' is unknown: give one of env, resets"),
        ("resets=9", "resets=9 is out of range: give a whole number of at least 10"),
        ("clouds.repeats=0", "clouds.repeats=0 is out of range"),
        ("env.num_envs=1.5", "env.num_envs=1.5 is no whole number"),
        ("collector.num_workers=-1", "collector.num_workers=-1 is out of range"),
        ("device=toaster", "device=toaster cannot be used"),
    ],
)
def test_impossible_values_are_refused_by_their_place(composed, override, told):
    with pytest.raises(ConfigError, match=f"^{told}"):
        benchmark.benchmark(composed(override))


def test_another_configuration_leaves_hydra_as_it_was(composed):
    assert not GlobalHydra.instance().is_initialized()
    assert compose_config("td3_bc", ["experiment=smoke"]).env.horizon == 6
    assert not GlobalHydra.instance().is_initialized()
    assert composed("seed=3").seed == 3
