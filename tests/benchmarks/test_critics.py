"""The suite `critics`, on a few episodes, and its figures by hand."""

import critics
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from torchgrasp.errors import ConfigError

FEW = ["critics.episodes=2", "critics.held_out=2", "critics.states=2", "critics.updates=2", "critics.tries=3"]
SMALL = [
    "objects.num_objects=2",
    "objects.num_grasps=100",
    "evaluation.num_objects=2",
    "evaluation.num_envs=2",
]
OVERRIDES = "critics.overrides=[" + ",".join(f"'{each}'" for each in SMALL) + "]"


@pytest.mark.slow
def test_critics_learn_from_episodes_of_the_shipped_policy(composed, capsys):
    given = [*FEW, OVERRIDES, "critics.ways=['2-step, layer, 1 values',tries]"]
    row, tried = critics.benchmark_critics(composed(*given, "collector.num_workers=0"))
    assert row["episodes"] == 2 and row["states"] == 2 and row["quality"]["episodes"] == 2
    assert 0.0 <= row["lifted_by_best"] <= 1.0
    assert tried["way"] == "tries" and tried["states"] == 2
    assert "critic 2-step, layer, 1 values" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("1-step", (1, "none", 2)),
        ("5-step, layer", (5, "layer", 2)),
        ("return, 5 values", (critics._ALL, "none", 5)),
        ("tries, layer, 5 values", (None, "layer", 5)),
        ("12-step, layer, 1 values", (12, "layer", 1)),
    ],
)
def test_a_way_names_steps_norm_and_values(name, expected):
    assert critics._read_way(name) == expected


def test_actions_of_a_state_are_ranked_by_hand():
    """The critic likes large x. Of the first state it orders three of four pairs, of the second all two."""
    critic = TensorDictModule(lambda action: action[..., :1], ["action"], ["state_action_value"])
    x = torch.tensor([[0.0, 0.2, 0.4, 0.6], [0.0, 0.1, 0.2, 0.3]])
    tried = torch.zeros(2, 4, 6)
    tried[..., 0] = x
    lifted = torch.tensor([[False, True, False, True], [True, False, True, True]])
    told = critics._rank(critic, TensorDict({"tried": tried, "lifted": lifted}, [2]))
    assert told["auc_of_actions"] == pytest.approx((3 / 4 + 2 / 3) / 2)
    assert told["auc_of_small_changes"] == pytest.approx((1 / 4 + 1 / 3) / 2)
    assert (told["lifted_by_policy"], told["lifted_by_best"], told["lifted_by_any"]) == (0.5, 1.0, 1.0)


def test_each_step_is_followed_by_the_next_one():
    ends = {key: torch.tensor([[False], [False], [True]]) for key in ("terminated", "done")}
    following = {**ends, "reward": torch.tensor([[0.0], [0.0], [1.0]])}
    state = {"time_left": torch.arange(3.0)[:, None], "action": torch.zeros(3, 6)}
    steps = TensorDict({**state, "next": following}, [3])
    told = critics._follow(steps, ["time_left", "action"])
    assert told["next", "time_left"].flatten().tolist() == [1.0, 2.0, 2.0]
    assert critics._outcomes(told[None]).tolist() == [1.0]


@pytest.mark.parametrize("way", ["0-step", "layer", "2 step", "'return, 0 values'"])
def test_unknown_ways_are_refused(composed, way):
    with pytest.raises(ConfigError, match=r"critics\.ways"):
        critics.benchmark_critics(composed(f"critics.ways=[{way}]"))
