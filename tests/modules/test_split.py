"""A network in two computes what it computes whole, and trains it."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import (
    GivenFeature,
    GoalPredictor,
    GraspActor,
    GraspCritic,
    PointNet,
    ResNet18,
    split_network,
)
from torchgrasp.objectives import GraspTD3BCLoss

CLOUD = partial(PointNet, out_features=16, hidden=(8, 16))
KEY = ("features", "it")
LATE = partial(GraspCritic, fusion="late")


def make_batch(n=5):
    torch.manual_seed(0)
    sizes = {"time_left": 1, "table_plane": 4, "goal": 7, "wrist_angle": 1, "action": 6}
    state = {key: torch.rand(n, size) for key, size in sizes.items()}
    return TensorDict({**state, "points": torch.rand(n, 20, 4), "image": torch.rand(n, 3, 16, 16)}, [n])


@pytest.mark.parametrize("make", [GraspActor, LATE, GoalPredictor])
@pytest.mark.parametrize("options", [{}, {"table_input": True, "state_inputs": {"wrist_angle": 1}}])
def test_the_two_parts_compute_what_the_whole_does(make, options):
    if make is not GoalPredictor:
        options = {**options, "goal_input": True, "freeze_encoder": True}
    network, batch = make(CLOUD, **options), make_batch()
    encoder, rest = split_network(network, KEY)
    assert encoder.in_keys == ["points", *["table_plane"] * ("table_input" in options)]
    features = encoder(batch.copy()).exclude("points")
    assert features[KEY].shape == (5, 16) and rest.in_keys[0] == KEY and "points" not in rest.in_keys
    for key in network.out_keys:
        assert torch.equal(rest(features)[key], network(batch.copy())[key])
    own = {id(each) for each in network.parameters()}
    parts = [*encoder.parameters(), *rest.parameters()]
    assert {id(each) for each in parts} == own and len(parts) == len(own)


def test_images_are_split_alike():
    encoder = partial(ResNet18, width=0.25)
    actor = GraspActor(encoder, in_channels=3, in_keys=["image", "time_left"], table_input=True)
    first, rest = split_network(actor, KEY)
    assert first.in_keys == ["image"]
    batch = make_batch()
    assert torch.equal(rest(first(batch.copy()))["action"], actor(batch)["action"])


def test_what_trains_the_rest_trains_the_network():
    actor, critic = GraspActor(CLOUD, freeze_encoder=True), LATE(CLOUD, freeze_encoder=True)
    halves = [split_network(each, ("features", name)) for name, each in (("a", actor), ("c", critic))]
    loss = GraspTD3BCLoss(*(rest for _, rest in halves), action_bound=ACTION_BOUND, bc_weight=0.0)
    names = {name for name, _ in loss.named_parameters()}
    assert names and not any("encoder" in name for name in names)
    batch = make_batch()
    for encoder, _ in halves:
        encoder(batch)
    after = {**batch.exclude("action"), "reward": torch.ones(5, 1), "terminated": torch.ones(5, 1).bool()}
    terms = loss(batch.exclude("points", "image").set("next", TensorDict(after, [5])))
    sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
    for network in (actor, critic):
        for name, each in network.named_parameters():
            assert (each.grad is not None) == ("encoder" not in name), name


def test_a_critic_that_sees_the_action_early_is_refused():
    with pytest.raises(ConfigError, match=r"joins the action to what its encoder reads.*fusion='late'"):
        split_network(GraspCritic(CLOUD), KEY)
    with pytest.raises(ConfigError, match="fusion='early' needs a cloud or an image"):
        GraspCritic(GivenFeature(16))


def test_other_networks_are_refused():
    from tensordict.nn import TensorDictModule

    with pytest.raises(ConfigError, match="has no encoder of its own"):
        split_network(TensorDictModule(torch.nn.Linear(2, 2), ["a"], ["b"]), KEY)


def test_features_of_another_size_are_refused():
    with pytest.raises(ConfigError, match=r"features of shape \(2, 3\)"):
        GivenFeature(4)(torch.zeros(2, 3))
