"""Actor and critic: keys, shapes, bounds, fusion, orders of encoders."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded
from torchrl.objectives import SoftUpdate, TD3Loss

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GraspActor, GraspCritic, PointNet, PointNet2

SMALL = partial(PointNet, out_features=16, hidden=(8, 16))


def _batch(*shape):
    state = {"points": 0.1 * torch.rand(*shape, 40, 4), "time_left": torch.rand(*shape, 1)}
    return TensorDict({**state, "action": torch.zeros(*shape, 6)}, shape)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
@pytest.mark.parametrize("encoder", [SMALL, partial(PointNet2, width=0.1)])
def test_shapes(shape, encoder):
    written = GraspCritic(encoder, num_q=3)(GraspActor(encoder)(_batch(*shape)))
    assert written["action"].shape == (*shape, 6)
    assert written["goal_prediction"].shape == (*shape, 7)
    assert written["state_action_value"].shape == (*shape, 3)


def test_actions_stay_within_their_bounds():
    actor = GraspActor(SMALL)
    for parameter in actor.parameters():
        parameter.data.mul_(30)
    action = actor(_batch(64))["action"]
    bound = torch.tensor(ACTION_BOUND)
    assert (action.abs() <= bound).all()
    assert (action.abs() > 0.9 * bound).any()


def test_an_untrained_actor_hardly_moves():
    assert (GraspActor(SMALL)(_batch(64))["action"].abs() < 0.2 * torch.tensor(ACTION_BOUND)).all()


def test_goals_are_unit_quaternions():
    goal = GraspActor(SMALL)(_batch(8))["goal_prediction"]
    torch.testing.assert_close(goal[..., 3:].norm(dim=-1), torch.ones(8))


@pytest.mark.parametrize("fusion", ["early", "late"])
def test_values_depend_on_action_and_time(fusion):
    critic, batch = GraspCritic(SMALL, fusion=fusion), _batch(4)
    before = critic(batch.clone())["state_action_value"]
    moved = critic(batch.clone().set("action", torch.full((4, 6), 0.05)))["state_action_value"]
    later = critic(batch.clone().set("time_left", batch["time_left"] - 0.5))["state_action_value"]
    assert (before != moved).all()
    assert (before != later).all()
    assert (before[:, 0] != before[:, 1]).all()


def test_early_fusion_gives_the_encoder_the_action():
    assert GraspCritic(SMALL).module.encoder.in_channels == 10
    assert GraspCritic(SMALL, fusion="late").module.encoder.in_channels == 4


def test_keys_are_settable():
    actor = GraspActor(
        SMALL, in_keys=[("obs", "cloud"), "clock"], out_keys=[("policy", "move")], action_bound=[1.0, 2.0]
    )
    td = TensorDict({"obs": {"cloud": torch.rand(2, 9, 4)}, "clock": torch.ones(2, 1)}, [2])
    assert actor(td)["policy", "move"].shape == (2, 2)
    assert "goal_prediction" not in td


def test_a_goal_conditioned_actor():
    actor = GraspActor(SMALL, vector_size=8, in_keys=["points", "time_left", "goal"])
    batch = _batch(2).set("goal", torch.rand(2, 7))
    assert actor(batch)["action"].shape == (2, 6)


def test_dispatch():
    action, goal = GraspActor(SMALL)(points=torch.rand(2, 9, 4), time_left=torch.ones(2, 1))
    assert action.shape == (2, 6)
    assert goal.shape == (2, 7)


def test_a_finished_encoder_is_used_as_it_is():
    encoder = PointNet(4)
    assert GraspActor(encoder).module.encoder is encoder


@pytest.mark.parametrize("encoder", [SMALL, partial(PointNet2, width=0.1)])
def test_torchrls_own_loss_takes_them(encoder):
    spec = Bounded(-torch.tensor(ACTION_BOUND), torch.tensor(ACTION_BOUND))
    networks = GraspActor(encoder), GraspCritic(encoder, num_q=1)
    loss = TD3Loss(*networks, action_spec=spec, deactivate_vmap=True)
    SoftUpdate(loss, tau=0.01)
    ends = {
        "reward": torch.ones(3, 1),
        "done": torch.zeros(3, 1).bool(),
        "terminated": torch.zeros(3, 1).bool(),
    }
    out = loss(_batch(3).set("next", _batch(3).exclude("action").update(ends)))
    (out["loss_actor"] + out["loss_qvalue"]).backward()
    assert all(p.grad is not None for p in networks[0].module.encoder.parameters())


def test_state_dict_round_trip():
    first, second, batch = GraspCritic(SMALL), GraspCritic(SMALL), _batch(3)
    second.load_state_dict(first.state_dict())
    for key in first.out_keys:
        assert torch.equal(first(batch.clone())[key], second(batch.clone())[key])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            lambda: GraspActor(lambda channels: nn.Linear(channels, 2).requires_grad_(), out_keys=[]),
            "out_keys",
        ),
        (lambda: GraspActor(lambda channels: nn.Identity()), "out_features"),
        (lambda: GraspActor(SMALL, action_bound=[0.1, -1.0]), "action_bound"),
        (lambda: GraspCritic(SMALL, fusion="middle"), "fusion"),
        (lambda: GraspCritic(SMALL, num_q=0), "num_q"),
    ],
)
def test_wrong_options_are_refused(wrong, message):
    with pytest.raises(ConfigError, match=message):
        wrong()
