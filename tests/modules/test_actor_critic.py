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
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic, PointNet, PointNet2, ResNet18

SMALL = partial(PointNet, out_features=16, hidden=(8, 16))
IMAGE = ["image", "time_left"]


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


def test_nested_keys_may_be_lists_as_yaml_has_them():
    actor = GraspActor(SMALL, out_keys=[["agent", "action"], "goal_prediction"])  # pyright: ignore
    predictor = GoalPredictor(SMALL, goal_key=["agent", "goal"])  # pyright: ignore
    written = predictor(actor(_batch(3)))
    assert written["agent", "action"].shape == (3, 6) and written["agent", "goal"].shape == (3, 7)


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


def test_values_of_normalised_heads_stay_small_far_from_the_data():
    """A head with LayerNorm cannot grow with its input, however far that is from what it was trained on."""
    batch = _batch(4)
    plain, bounded = (GraspCritic(SMALL, fusion="late", norm=norm) for norm in ("none", "layer"))
    assert sum(isinstance(each, nn.LayerNorm) for each in bounded.module.value_heads.modules()) == 4
    far = batch.clone().update({"action": 1e4 * torch.ones(4, 6)})
    grown = [critic(far.clone())["state_action_value"].abs().max() for critic in (plain, bounded)]
    assert grown[0] > 100 and grown[1] < 10


def test_early_fusion_gives_the_encoder_the_action():
    assert GraspCritic(SMALL).module.encoder.in_channels == 10
    assert GraspCritic(SMALL, fusion="late").module.encoder.in_channels == 4


def test_keys_are_settable():
    actor = GraspActor(
        SMALL,
        in_keys=[("obs", "cloud"), "clock"],
        goal_input=True,
        goal_key=("obs", "grasp"),
        goal_prediction=False,
        out_keys=[("policy", "move")],
        action_bound=[1.0, 2.0],
    )
    seen = {"cloud": torch.rand(2, 9, 4), "grasp": torch.zeros(2, 7)}
    td = TensorDict({"obs": seen, "clock": torch.ones(2, 1)}, [2])
    assert actor(td)["policy", "move"].shape == (2, 2)
    assert "goal_prediction" not in td


@pytest.mark.parametrize("goal_input", [True, False])
@pytest.mark.parametrize("make", [GraspActor, GraspCritic])
def test_the_goal_counts_where_it_is_an_input(make, goal_input):
    network = make(SMALL, goal_input=goal_input)
    batch = _batch(4).set("goal", torch.zeros(4, 7))
    assert ("goal" in network.in_keys) is goal_input
    other = batch.clone().set("goal", torch.ones(4, 7))
    first, second = (network(td)[network.out_keys[0]] for td in (batch, other))
    assert (first != second).all() if goal_input else torch.equal(first, second)


@pytest.mark.parametrize("make", [GraspActor, GraspCritic])
def test_the_goal_head_can_be_left_out(make):
    network = make(SMALL, goal_prediction=False)
    assert len(network.out_keys) == 1 and not any("goal" in name for name, _ in network.named_parameters())


def test_a_goal_network_writes_what_labels_look_like():
    """A unit quaternion with w >= 0, whatever sign its head gives to the same rotation."""
    network, batch = GoalPredictor(SMALL), _batch(8)
    network.module.goal_head.layers[-1].bias.data.neg_()
    goal = network(batch)["goal"]
    feature = torch.cat((network.module.encoder(batch["points"]), batch["time_left"]), dim=-1)
    raw = network.module.goal_head(feature)
    assert (raw[:, 6] < 0).all()
    assert (goal[:, 6] >= 0).all()
    torch.testing.assert_close(goal[:, 3:].norm(dim=-1), torch.ones(8))
    torch.testing.assert_close(goal, torch.cat((raw[:, :3], -raw[:, 3:]), dim=-1))


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
@pytest.mark.parametrize("fusion", ["early", "late"])
def test_images(shape, fusion):
    encoder = partial(ResNet18, width=0.25)
    actor = GraspActor(encoder, in_channels=5, in_keys=IMAGE, goal_input=True)
    critic = GraspCritic(encoder, in_channels=5, in_keys=[*IMAGE, "action"], fusion=fusion)
    assert critic.module.encoder.in_channels == (11 if fusion == "early" else 5)
    seen = {"image": torch.rand(*shape, 5, 32, 32), "goal": torch.zeros(*shape, 7)}
    written = critic(actor(_batch(*shape).update(seen)))
    assert written["action"].shape == (*shape, 6)
    assert written["state_action_value"].shape == (*shape, 2)


class Recorder(nn.Module):
    """Keeps what it is given, and says where its channels are."""

    def __init__(self, channel_dim):
        super().__init__()
        self.out_features, self.channel_dim = 1, channel_dim

    def forward(self, observed):
        self.observed = observed
        return observed.flatten(1).sum(dim=1, keepdim=True)


@pytest.mark.parametrize(("dim", "shape"), [(-1, (2, 9, 4)), (-3, (2, 4, 5, 7))])
def test_early_fusion_joins_the_action_in_units_of_its_bound(dim, shape):
    encoder = Recorder(dim)
    action = torch.tensor([[0.03, 0.0], [-0.06, 0.5]])
    td = TensorDict({"points": torch.rand(shape), "time_left": torch.ones(2, 1), "action": action}, [2])
    GraspCritic(encoder, action_bound=[0.06, 1.0])(td)
    own, joined = encoder.observed.split((4, 2), dim=dim)
    assert torch.equal(own, td["points"])
    for row, values in enumerate([(0.5, 0.0), (-1.0, 0.5)]):
        for channel, value in enumerate(values):
            everywhere = joined[row].select(dim, channel)
            torch.testing.assert_close(everywhere, torch.full_like(everywhere, value))


@pytest.mark.parametrize("fusion", ["early", "late"])
def test_bytes_are_no_image(fusion):
    encoder = partial(ResNet18, width=0.25)
    critic = GraspCritic(encoder, in_channels=3, fusion=fusion, in_keys=[*IMAGE, "action"])
    seen = _batch(2).set("image", torch.ones(2, 3, 32, 32, dtype=torch.uint8))
    with pytest.raises(ConfigError, match="colours in"):
        critic(seen)


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16])
@pytest.mark.parametrize("encoder", [SMALL, partial(PointNet2, width=0.1)])
def test_a_network_of_any_precision_takes_float32(encoder, dtype):
    batch = _batch(3).set("goal", torch.zeros(3, 7))
    networks = (
        GoalPredictor(encoder),
        GraspActor(encoder, goal_input=True),
        GraspCritic(encoder),
        GraspCritic(encoder, fusion="late"),
    )
    for network in networks:
        seen = network.to(dtype)(batch.clone())
        assert {seen[key].dtype for key in network.out_keys} == {dtype}


def test_dispatch():
    action, goal = GraspActor(SMALL)(points=torch.rand(2, 9, 4), time_left=torch.ones(2, 1))
    assert action.shape == (2, 6)
    assert goal.shape == (2, 7)


def test_a_finished_encoder_is_used_as_it_is():
    encoder = PointNet(4)
    assert GraspActor(encoder).module.encoder is encoder


def _torchrl_loss(encoder, *, vmap):
    """Terms of torchrl's TD3Loss with two critics, and the encoder of the actor."""
    spec = Bounded(-torch.tensor(ACTION_BOUND), torch.tensor(ACTION_BOUND))
    options = {"goal_input": True, "goal_prediction": False}
    networks = GraspActor(encoder, **options), GraspCritic(encoder, num_q=1, **options)
    loss = TD3Loss(*networks, action_spec=spec, deactivate_vmap=not vmap)
    SoftUpdate(loss, tau=0.01)
    end = torch.zeros(3, 1).bool()
    state = _batch(3).set("goal", torch.rand(3, 7))
    following = state.exclude("action").update({"reward": torch.ones(3, 1), "done": end, "terminated": end})
    return loss(state.set("next", following)), networks[0].module.encoder


@pytest.mark.parametrize("vmap", [False, True])
@pytest.mark.parametrize("encoder", [SMALL, partial(PointNet2, width=0.1)])
def test_torchrls_own_loss_takes_them(encoder, vmap):
    """By a loop over the critics, and by TorchRL's vmap over their stacked weights."""
    out, built = _torchrl_loss(encoder, vmap=vmap)
    (out["loss_actor"] + out["loss_qvalue"]).backward()
    assert all(p.grad is not None for p in built.parameters())


def test_state_dict_round_trip():
    first, second, batch = GraspCritic(SMALL), GraspCritic(SMALL), _batch(3)
    second.load_state_dict(first.state_dict())
    for key in first.out_keys:
        assert torch.equal(first(batch.clone())[key], second(batch.clone())[key])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            lambda: GraspActor(SMALL, out_keys=["action"]),
            "goal_prediction=False",
        ),
        (lambda: GraspActor(SMALL, out_keys=[], goal_prediction=False), "out_keys"),
        (lambda: GraspActor(SMALL, in_keys=["points", "time_left", "goal"]), "in_keys"),
        (lambda: GraspCritic(SMALL, in_keys=["points", "time_left"]), "the action"),
        (lambda: GraspActor(lambda channels: nn.Identity()), "out_features"),
        (lambda: GraspActor(SMALL, action_bound=[0.1, -1.0]), "action_bound"),
        (lambda: GraspActor(SMALL, action_bound=2.0), "action_bound=2.0"),
        (lambda: GraspActor(SMALL, action_bound=[float("inf")]), "finite"),
        (lambda: GraspCritic(SMALL, fusion="middle"), "fusion"),
        (lambda: GraspCritic(SMALL, num_q=0), "num_q"),
    ],
)
def test_wrong_options_are_refused(wrong, message):
    with pytest.raises(ConfigError, match=message):
        wrong()


def test_what_is_not_asked_for_is_not_computed_and_the_rest_is_the_same():
    actor, critic, batch = GraspActor(SMALL), GraspCritic(SMALL, num_q=3), _batch(5)
    action = actor(batch.copy(), predict_goal=False)
    assert "goal_prediction" not in action and torch.equal(action["action"], actor(batch.copy())["action"])
    whole = critic(batch.copy())
    for heads in (slice(0, 1), slice(1, None)):
        part = critic(batch.copy(), predict_goal=False, values=heads)
        assert "goal_prediction" not in part
        assert torch.equal(part["state_action_value"], whole["state_action_value"][:, heads])
