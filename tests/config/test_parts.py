"""Errors of parts are told with their place in the configuration."""

import pytest
from omegaconf import OmegaConf

from torchgrasp.config.parts import at_place, build
from torchgrasp.errors import ConfigError, check_range

CFG = OmegaConf.create(
    {
        "transforms": {"aggregate": {"_target_": "torchgrasp.transforms.AggregatePoints", "alpha": 2}},
        "model": {
            "encoder": {"_target_": "torchgrasp.modules.PointNet", "_partial_": True, "width": -1.0},
            "actor": {"_target_": "torchgrasp.modules.GraspActor", "encoder": "${model.encoder}"},
        },
        "start": {"_target_": "torchgrasp.envs.StartPoses", "table_x": [0.9, 0.1]},
        "absent": None,
    }
)


def test_an_argument_of_the_node_gets_its_place_in_front():
    with pytest.raises(ConfigError, match=r"^transforms\.aggregate\.alpha=2 is out of range"):
        build(CFG.transforms.aggregate)
    with pytest.raises(ConfigError, match=r"^start\.table_x"):
        build(CFG.start)


def test_what_a_part_inside_says_is_told_behind_the_node_that_was_built():
    with pytest.raises(ConfigError, match=r"^model\.actor: width=-1"):
        build(CFG.model.actor)


def test_a_library_alone_knows_nothing_of_a_configuration():
    from torchgrasp.transforms import AggregatePoints

    with pytest.raises(ConfigError, match=r"^alpha=2 is out of range"):
        AggregatePoints(alpha=2)


def test_nothing_is_built_of_nothing():
    assert build(CFG.absent) is None


def test_errors_of_functions_get_the_place_that_they_are_called_at():
    with pytest.raises(ConfigError, match=r"^replay\.capacity=-1 is out of range"), at_place("replay"):
        check_range("capacity", -1, 0, 9)
    with pytest.raises(ConfigError, match=r"^Of 5 steps none counts"), at_place("demonstrations"):
        raise ConfigError("Of 5 steps none counts: give others.")
