"""StaggeredTargetUpdate: what follows, what is copied, when, and resuming."""

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.objectives import GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate

NAME = ("module", "outputs", "0")


def _shift(params, by):
    params[NAME].data += by


def test_schedule(constant_actor, constant_critic):
    """Online values jump from 0 to 1: after n soft steps of 0.1 the target is 1 - 0.9^n."""
    loss = GraspTD3BCLoss(constant_actor(), constant_critic((0.0, 0.0)), action_bound=ACTION_BOUND)
    updater = StaggeredTargetUpdate(loss, tau=0.1, period=3)
    _shift(loss.critic_network_params, 1.0)
    _shift(loss.actor_network_params, 1.0)
    for n in range(1, 8):
        updater.step()
        soft = torch.full((2,), 1 - 0.9**n)
        torch.testing.assert_close(loss.target_critic_network_params[NAME].data, soft)
        torch.testing.assert_close(loss.target_actor_network_params[NAME].data, soft[:1].expand(6))
        expected = torch.full((2,), float(n >= 3))
        assert torch.equal(loss.target_delayed_critic_network_params[NAME].data, expected)


def test_copies_are_copies(constant_actor, constant_critic):
    loss = GraspTD3BCLoss(constant_actor(), constant_critic((0.0, 0.0)), action_bound=ACTION_BOUND)
    updater = StaggeredTargetUpdate(loss, period=1)
    updater.step()
    _shift(loss.critic_network_params, 5.0)
    assert not loss.target_delayed_critic_network_params[NAME].any()


def test_copy_sets_every_target(constant_actor, constant_critic):
    loss = GraspTD3BCLoss(constant_actor(), constant_critic((0.0, 0.0)), action_bound=ACTION_BOUND)
    updater = StaggeredTargetUpdate(loss, tau=0.1, period=3)
    _shift(loss.critic_network_params, 2.0)
    _shift(loss.actor_network_params, 2.0)
    updater.copy()
    for target in ("actor", "critic", "delayed_critic"):
        assert (getattr(loss, f"target_{target}_network_params")[NAME] == 2.0).all()
    assert updater.counter == 0


def test_in_a_list_the_first_follows_and_the_others_are_copied(constant_actor, constant_critic):
    critics = [constant_critic((0.0,)) for _ in range(3)]
    loss = GraspTD3BCLoss(constant_actor(), critics, action_bound=ACTION_BOUND)
    updater = StaggeredTargetUpdate(loss, tau=0.25, period=2)
    for critic in critics:
        critic.module.outputs[0].data += 1
    seen = []
    for _ in range(2):
        updater.step()
        targets = loss.target_critic_network_params["critics"]
        seen.append([targets[str(i)][NAME].item() for i in range(3)])
    assert seen == [[0.25, 0.0, 0.0], [0.4375, 1.0, 1.0]]


def test_buffers_go_along(constant_actor, batch):
    network = nn.Sequential(nn.BatchNorm1d(7), nn.Linear(7, 2))
    critic = TensorDictModule(
        _Joined(network), in_keys=["time_left", "action"], out_keys=["state_action_value"]
    )
    loss = GraspTD3BCLoss(constant_actor(goal=None), critic, bc_weight=0.0, action_bound=ACTION_BOUND)
    updater = StaggeredTargetUpdate(loss, tau=0.5, period=2)
    statistics = ("module", "network", "0", "running_mean")
    loss.critic_network_params[statistics].fill_(1.0)
    updater.step()
    assert loss.target_critic_network_params[statistics].unique().item() == 0.5
    updater.step()
    assert loss.target_delayed_critic_network_params[statistics].unique().item() == 1.0


class _Joined(nn.Module):
    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, *inputs):
        return self.network(torch.cat(inputs, dim=-1))


def test_the_counter_resumes(constant_actor, constant_critic):
    def make():
        loss = GraspTD3BCLoss(constant_actor(), constant_critic((0.0, 0.0)), action_bound=ACTION_BOUND)
        return loss, StaggeredTargetUpdate(loss, period=3)

    (first, updater), (second, resumed) = make(), make()
    updater.step()
    updater.step()
    second.load_state_dict(first.state_dict())
    resumed.load_state_dict(updater.state_dict())
    _shift(second.critic_network_params, 1.0)
    resumed.step()
    assert second.target_delayed_critic_network_params[NAME].tolist() == [1.0, 1.0]


def test_wrong_use_says_what_to_do(constant_actor, constant_critic):
    loss = GraspTD3BCLoss(
        constant_actor(), constant_critic(), staggered_targets=False, action_bound=ACTION_BOUND
    )
    with pytest.raises(ConfigError, match="staggered_targets=True"):
        StaggeredTargetUpdate(loss)
    with pytest.raises(ConfigError, match="PoseBCLoss"):
        StaggeredTargetUpdate(PoseBCLoss(constant_actor()))
    loss = GraspTD3BCLoss(constant_actor(), constant_critic(), action_bound=ACTION_BOUND)
    for wrong in ({"tau": 1.5}, {"period": 0}, {"period": 2.5}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            StaggeredTargetUpdate(loss, **wrong)
