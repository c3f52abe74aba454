"""ValueChoice: the best of several actions in a critic's eyes."""

from __future__ import annotations

import pickle

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor

from torchgrasp.errors import ConfigError
from torchgrasp.modules import GraspActor, GraspCritic, PointNet, ValueChoice

BOUND = [2.0, 1.0]


def make_choice(*, best: tuple[float, float] = (1.0, 1.0), **options) -> ValueChoice:
    """Of a policy that does nothing, by a critic that likes actions close to `best`."""

    def judge(place: Tensor, action: Tensor) -> Tensor:
        near = -(action - torch.tensor(best)).square().sum(-1, keepdim=True) + 0 * place
        return torch.cat((near, near - 3.0 * action[..., :1].abs()), dim=-1)

    policy = TensorDictModule(
        lambda place: (0 * place.expand(*place.shape[:-1], 2), place), ["place"], ["action", "goal"]
    )
    critic = TensorDictModule(judge, ["place", "action"], ["state_action_value"])
    return ValueChoice(policy, critic, **{"action_bound": BOUND, "statistic": "mean", **options})


def make_state(*shape: int) -> TensorDict:
    return TensorDict({"place": torch.randn(*shape, 1)}, shape)


def test_it_acts_better_and_within_reach() -> None:
    choice = make_choice(num_nearby=256, reach=[0.1, 0.5], best=(-1.0, 1.0))
    action = choice(make_state(5))["action"]
    assert action.shape == (5, 2)
    assert ((action.abs() <= torch.tensor([0.2, 0.5]) + 1e-6).all(dim=-1)).all()
    assert (action[:, 1] > 0.4).all()


def test_actions_stay_within_their_limits() -> None:
    choice = make_choice(num_nearby=512, reach=1.0, best=(9.0, 9.0), statistic="mean")
    choice.policy = TensorDictModule(
        lambda place: (0 * place + torch.tensor([1.9, 0.9]), place), ["place"], ["action", "goal"]
    )
    action = choice(make_state(2))["action"]
    assert torch.allclose(action, torch.tensor(BOUND).expand(2, 2), atol=0.1)
    assert (action <= torch.tensor(BOUND)).all()


def test_it_is_deterministic_and_the_seed_decides() -> None:
    state = make_state(3)
    first, again = (make_choice(num_nearby=16)(state.copy())["action"] for _ in range(2))
    assert torch.equal(first, again)
    assert not torch.equal(first, make_choice(num_nearby=16, seed=1)(state.copy())["action"])


def test_the_policy_keeps_its_action_where_the_gain_is_small() -> None:
    assert torch.equal(make_choice(margin=100.0)(make_state(3))["action"], torch.zeros(3, 2))
    assert torch.equal(make_choice(num_nearby=0)(make_state(3))["action"], torch.zeros(3, 2))
    assert not torch.equal(make_choice(margin=0.01)(make_state(3))["action"], torch.zeros(3, 2))


def test_the_least_value_counts_on_demand() -> None:
    bold, careful = (
        make_choice(num_nearby=256, reach=0.4, statistic=each)(make_state(1)) for each in ("mean", "min")
    )
    assert careful["action"][0, 0].abs() < bold["action"][0, 0].abs()


def test_other_actions_of_the_policy_are_tried() -> None:
    policy = TensorDictModule(
        lambda place: (0 * place.expand(-1, 2), torch.ones(len(place), 2)), ["place"], ["action", "mine"]
    )
    critic = make_choice().critic
    choice = ValueChoice(
        policy, critic, num_nearby=0, other_keys=["mine"], action_bound=BOUND, statistic="mean"
    )
    written = choice(make_state(3))
    assert torch.equal(written["action"], torch.ones(3, 2))
    assert torch.equal(written["mine"], torch.ones(3, 2))


def test_the_value_of_what_is_done_is_written() -> None:
    choice = make_choice(num_nearby=32, statistic="min")
    written = choice(make_state(3))
    expected = choice.critic(written.copy())["state_action_value"].amin(-1, keepdim=True)
    assert torch.allclose(written["state_action_value"], expected)
    assert written["goal"].shape == (3, 1)


def test_any_batch_of_networks_will_do_in_another_process_too() -> None:
    actor, critic = GraspActor(PointNet), GraspCritic(PointNet)
    choice = ValueChoice(actor, critic, num_nearby=4, action_bound=[0.06] * 3 + [0.3] * 3)
    assert choice.in_keys == ["points", "time_left"]
    assert choice.out_keys == ["action", "goal_prediction", "state_action_value"]
    state = TensorDict({"points": torch.rand(6, 64, 4), "time_left": torch.ones(6, 1)}, [6])
    flat, square = choice(state.copy()), pickle.loads(pickle.dumps(choice))(state.reshape(2, 3))
    assert torch.allclose(flat["action"], square["action"].reshape(6, 6), atol=1e-6)


def test_keywords_and_smaller_batches_will_do() -> None:
    policy = TensorDictModule(lambda x: 0 * x, ["x"], ["action"])
    critic = TensorDictModule(lambda x, a: a + 0 * x, ["x", "action"], ["state_action_value"])
    choice, x = ValueChoice(policy, critic, reach=0.5, action_bound=[1.0]), torch.randn(3, 1)
    expected = choice(TensorDict({"x": x}, [3]))["action"]
    assert torch.equal(choice(x=x)[0], expected)
    assert torch.equal(choice(TensorDict({"x": x}))["action"], expected)


def test_nested_keys_will_do() -> None:
    policy = TensorDictModule(lambda x: 0 * x, [("seen", "x")], [("act", "torque")])
    critic = TensorDictModule(lambda x, a: a + 0 * x, [("seen", "x"), ("act", "torque")], [("told", "value")])
    keys = {"action_key": ("act", "torque"), "value_key": ("told", "value")}
    choice = ValueChoice(policy, critic, num_nearby=64, reach=0.5, action_bound=[1.0], **keys)
    written = choice(TensorDict({"seen": {"x": torch.ones(3, 1)}}, [3]))
    assert (written["act", "torque"] > 0.4).all() and written["told", "value"].shape == (3, 1)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"action_key": "torque"}, r"policy writes \['action', 'goal'\] and no \['torque'\]"),
        ({"other_keys": ["mine"]}, "and no \\['mine'\\]"),
        ({"other_keys": "goal"}, "other_keys='goal': give a list"),
        ({"action_key": "goal"}, "critic reads .* and no 'goal'"),
        ({"value_key": "worth"}, "critic writes .* and no 'worth'"),
    ],
)
def test_keys_that_nobody_writes_or_reads_are_refused(options: dict, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        make_choice(**options)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"num_nearby": -1}, "num_nearby=-1"),
        ({"margin": -0.1}, "margin=-0.1"),
        ({"statistic": "max"}, "statistic='max'"),
        ({"reach": 1.5}, "reach=1.5"),
        ({"reach": [0.1]}, "reach="),
        ({"action_bound": None}, "action_bound and action_spec are missing"),
    ],
)
def test_wrong_arguments_are_refused(options: dict, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        make_choice(**options)
