"""Frozen encoders (Sec. 6.3): they stay as they are, heads learn, gradients pass through to the action."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GraspActor, GraspCritic, PointNet, PointNet2, ResNet18
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate

CLOUD = partial(PointNet, out_features=16, hidden=(8, 16))
STATE = ["image", "time_left"]


def make_batch():
    torch.manual_seed(0)
    goal = torch.tensor([[0.0, 0, 0.1, 0, 0, 0, 1]]).expand(4, 7)
    state = {"points": 0.1 * torch.rand(4, 40, 4), "image": torch.rand(4, 3, 32, 32)}
    state["time_left"] = torch.rand(4, 1)
    ends = {"reward": torch.ones(4, 1), "terminated": torch.tensor([[True], [False]] * 2)}
    ends["done"] = ends["terminated"]
    labels = {"action": torch.zeros(4, 6), "expert_action": 0.01 * torch.ones(4, 6), "goal": goal}
    return TensorDict({**state, **labels, "next": {**state, **ends}}, [4])


def make_networks(kind):
    if kind == "image":
        encoder = partial(ResNet18, width=0.25, norm="batch")
        actor = GraspActor(encoder, in_channels=3, in_keys=STATE, freeze_encoder=True)
        return actor, GraspCritic(encoder, in_channels=3, in_keys=[*STATE, "action"], freeze_encoder=True)
    encoder = CLOUD if kind == "cloud" else partial(PointNet2, width=0.1, norm="batch")
    return GraspActor(encoder, freeze_encoder=True), GraspCritic(encoder, freeze_encoder=True)


def state_of(module):
    return {name: value.clone() for name, value in module.state_dict().items()}


@pytest.mark.parametrize("kind", ["cloud", "cloud with batch norm", "image"])
def test_encoders_stay_and_heads_learn(kind):
    actor, critic = make_networks(kind)
    loss = GraspTD3BCLoss(actor, critic, action_bound=ACTION_BOUND)
    targets = StaggeredTargetUpdate(loss, tau=0.5, period=1)
    loss.train()
    before = [state_of(network.module) for network in (actor, critic)]
    optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=1e-2)
    for _ in range(2):
        optimizer.zero_grad()
        out = loss(make_batch())
        sum(value for key, value in out.items() if key.startswith("loss_")).backward()
        optimizer.step()
        targets.step()
    for network, old in zip((actor, critic), before, strict=True):
        for name, value in network.module.state_dict().items():
            if name.startswith("encoder"):
                assert torch.equal(value, old[name]), name
            elif name != "bound":
                assert not torch.equal(value, old[name]), name


@pytest.mark.parametrize("make", [GraspActor, lambda e, **k: GraspCritic(e, fusion="late", **k)])
def test_freezing_a_module_leaves_its_other_owners_alone(make):
    encoder = CLOUD(4)
    open_actor = GraspActor(encoder)
    frozen = make(encoder, freeze_encoder=True)
    assert all(p.requires_grad for p in open_actor.parameters()) and encoder.training
    assert not any(p.requires_grad for p in frozen.module.encoder.parameters())
    for own, copied in zip(encoder.parameters(), frozen.module.encoder.parameters(), strict=True):
        assert torch.equal(own, copied) and own is not copied


def test_training_mode_passes_a_frozen_encoder_by():
    actor, critic = make_networks("image")
    loss = GraspTD3BCLoss(actor, critic, action_bound=ACTION_BOUND)
    for _ in range(2):
        loss.train()
        for network in (loss.actor_network, loss.critic_network):
            assert network.module.action_head.training if network is actor else network.training
            assert not any(module.training for module in network.module.encoder.modules())
        loss.eval()
    loose = GraspActor(CLOUD)
    assert loose.train().module.encoder.training


@pytest.mark.parametrize("kind", ["cloud", "cloud with batch norm", "image"])
def test_the_actor_learns_through_a_frozen_critic(kind):
    """DDPG alone: its gradient reaches the action by way of the encoder, and the actor's heads."""
    actor, critic = make_networks(kind)
    for value_head in critic.module.value_heads:
        value_head.requires_grad_(False)
    loss = GraspTD3BCLoss(actor, critic, action_bound=ACTION_BOUND, bc_weight=0.0, aux_weight=0.0)
    loss.actor_loss(make_batch())["loss_actor_ddpg"].backward()
    head = actor.module.action_head
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in head.parameters())
    assert all(p.grad is None for p in [*critic.parameters(), *actor.module.encoder.parameters()])


def test_a_frozen_network_takes_the_weights_of_one_that_was_not():
    trained, frozen = GraspActor(CLOUD), GraspActor(CLOUD, freeze_encoder=True)
    frozen.load_state_dict(trained.state_dict())
    batch = make_batch()
    # The one with a graph may take another path through the same sums, and round otherwise.
    torch.testing.assert_close(frozen(batch.clone())["action"], trained(batch.clone())["action"])
    assert not any(p.requires_grad for p in frozen.module.encoder.parameters())
