"""What a critic's values tell of how episodes end."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.value_quality import ValueTable, WatchingCritic, area_under_curve
from torchgrasp.rollouts import Episode


def test_the_area_is_the_share_of_pairs_in_order():
    rng = np.random.default_rng(0)
    scores, success = rng.integers(0, 5, 40) / 5, rng.random(40) < 0.7
    pairs = [(a > b) + 0.5 * (a == b) for a in scores[success] for b in scores[~success]]
    assert area_under_curve(scores, success) == pytest.approx(np.mean(pairs))


@pytest.mark.parametrize("success", [np.ones(3, bool), np.zeros(3, bool)])
def test_outcomes_that_are_all_alike_have_no_area(success):
    assert area_under_curve(np.arange(3.0), success) is None


def test_rows_by_hand():
    """With a discount of 0.5 the last action of a success is worth 1, the one before 0.5."""
    table = ValueTable(gamma=0.5)
    table.add([0.4, 0.8], success=True)
    table.add([0.3, 0.1], success=False)
    told = table.summary()
    assert told["episodes"] == 2 and list(told["steps_left"]) == ["2", "1"]
    last, before = told["steps_left"]["1"], told["steps_left"]["2"]
    assert last["auc"] == before["auc"] == 1.0
    assert last["error"] == pytest.approx((0.2**2 + 0.1**2) / 2)
    assert before["error"] == pytest.approx((0.1**2 + 0.3**2) / 2)
    assert before["error_of_rate"] == pytest.approx(0.25**2)
    assert (last["value_of_successes"], last["value_of_failures"]) == (0.8, 0.1)
    assert [(each["from"], each["steps"], each["success"]) for each in told["calibration"]] == [
        (0.1, 1, 0.0),
        (0.3, 1, 0.0),
        (0.4, 1, 0.5),
        (0.8, 1, 1.0),
    ]


def test_shorter_episodes_count_where_they_have_steps():
    table = ValueTable(gamma=1.0)
    table.add([0.9], success=True)
    table.add([0.1, 0.2, 0.3], success=False)
    rows = table.summary()["steps_left"]
    assert rows["1"]["auc"] == 1.0 and rows["3"]["auc"] is None
    assert rows["3"]["value_of_successes"] is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_no_numbers_are_refused(value):
    with pytest.raises(ConfigError, match="NaN or infinity"):
        ValueTable().add([0.1, value], success=True)


def test_nothing_was_added():
    assert ValueTable().summary() == {"episodes": 0, "gamma": 0.95, "steps_left": {}, "calibration": []}


def test_the_critic_only_watches():
    policy = TensorDictModule(lambda x: 2 * x, ["x"], ["action"])
    critic = TensorDictModule(
        lambda a, t: (torch.cat((a, a + t), -1), a),
        ["action", "t"],
        ["state_action_value", "goal_prediction"],
    )
    watching = WatchingCritic(policy, critic)
    assert watching.in_keys == ["x", "t"]
    steps = watching(TensorDict({"x": torch.ones(3, 1), "t": -torch.ones(3, 1)}, [3]))
    assert "goal_prediction" not in steps and torch.equal(steps["action"], 2 * torch.ones(3, 1))
    steps["next"] = TensorDict({"reward": torch.tensor([[0.0], [0.0], [1.0]])}, [3])
    table = ValueTable(gamma=1.0)
    table.watch(Episode(steps, "box", world=0, number=0))
    assert table.summary()["steps_left"]["1"]["value_of_successes"] == 1.0  # the least of 2 and 1


def test_episodes_without_values_are_refused():
    steps = TensorDict({"next": {"reward": torch.ones(3, 1)}}, [3])
    with pytest.raises(ConfigError, match="no values"):
        ValueTable().watch(Episode(steps, "box", world=0, number=0))
