"""What was given on the command line, told from what conf/ holds."""

import pytest
from omegaconf import OmegaConf

from torchgrasp.config.overrides import copy, given_names, given_values, merge, plain
from torchgrasp.errors import ConfigError


def test_outside_of_hydra_nothing_was_given():
    assert given_names() == [] and given_values("resume=run") == {}


def test_names_and_plain_values_of_the_command_line(on_command_line):
    on_command_line("seed=3", "+loss.extra=1", "~transforms.table", "online.updates=5")
    assert given_names()[1:] == ["seed", "loss.extra", "transforms.table", "online.updates"]
    on_command_line("seed=3", "online.milestones=[0.1,0.2]")
    assert given_values("resume=run") == {
        **{"output_dir": given_values("resume=run").output_dir, "seed": 3},
        "online": {"milestones": [0.1, 0.2]},
    }


@pytest.mark.parametrize(
    "given", ["+loss.extra=1", "~transforms.table", "model=pointnet", "experiment=smoke"]
)
def test_choices_additions_and_deletions_are_refused_where_a_run_is_resumed(on_command_line, given):
    on_command_line(given)
    with pytest.raises(ConfigError, match=r"^resume=run does not go with .*: give other plain values alone"):
        given_values("resume=run")


def test_copies_take_new_keys_and_leave_the_first_alone():
    cfg = OmegaConf.create({"a": {"b": 1}})
    OmegaConf.set_struct(cfg, True)
    copied = copy(cfg)
    copied.a.c = 2
    assert merge(copied, {"a": {"b": 3}}) == {"a": {"b": 3, "c": 2}} and cfg == {"a": {"b": 1}}


def test_plain_values_are_resolved():
    cfg = OmegaConf.create({"a": [1, 2], "b": "${a}"})
    assert plain(cfg.b) == [1, 2] and type(plain(cfg.b)) is list and plain("outputs/*") == "outputs/*"
