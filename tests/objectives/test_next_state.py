"""What networks read of the next state must be there: the present state never stands in for it."""

import pytest
import torch
from tensordict.nn import TensorDictModule

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate


@pytest.fixture
def make_loss(constant_actor, constant_critic):
    """A loss whose critic, or actor, also reads `goal`."""

    def make(reader):
        networks = {"actor": constant_actor(), "critic": constant_critic()}
        module = networks[reader]
        networks[reader] = TensorDictModule(module.module, [*module.in_keys, "goal"], list(module.out_keys))
        loss = GraspTD3BCLoss(networks["actor"], networks["critic"], action_bound=ACTION_BOUND)
        StaggeredTargetUpdate(loss)
        return loss

    return make


@pytest.mark.parametrize("reader", ["actor", "critic"])
def test_a_missing_entry_is_named_with_the_remedy(make_loss, batch, reader):
    loss = make_loss(reader)
    with pytest.raises(ConfigError, match=r"\('next', 'goal'\).*Record them.*copied"):
        loss.critic_loss(batch)
    assert ("next", "goal") in loss.in_keys
    batch["next", "goal"] = batch["goal"]  # the remedy
    assert loss.critic_loss(batch)["loss_qvalue"].isfinite()


def test_the_actor_side_needs_no_next_state(make_loss, batch):
    assert make_loss("critic").actor_loss(batch.exclude("next"))["loss_actor_ddpg"].isfinite()


@pytest.mark.parametrize("missing", ["next", ("next", "reward"), ("next", "terminated")])
def test_missing_ends_are_named(constant_actor, constant_critic, batch, missing):
    loss = GraspTD3BCLoss(constant_actor(), constant_critic(), action_bound=ACTION_BOUND)
    StaggeredTargetUpdate(loss)
    with pytest.raises(ConfigError, match=missing[-1] if isinstance(missing, tuple) else missing):
        loss.critic_loss(batch.exclude(missing))


def test_a_missing_state_is_named(constant_actor, constant_critic, batch):
    loss = GraspTD3BCLoss(constant_actor(), constant_critic(), action_bound=ACTION_BOUND)
    with pytest.raises(ConfigError, match="time_left"):
        loss.actor_loss(batch.exclude("time_left"))


def test_the_next_value_counts_and_the_present_one_does_not(constant_actor, batch):
    """Q = goal's x of the next state: y is read off it, whatever the present goal is."""
    critic = TensorDictModule(lambda goal: goal[..., :1], ["goal"], ["q"])
    loss = GraspTD3BCLoss(constant_actor(goal=None), critic, bc_weight=0.0, action_bound=ACTION_BOUND)
    StaggeredTargetUpdate(loss)
    loss.set_keys(state_action_value="q")
    batch["next", "goal"] = torch.full((4, 7), 0.3)
    for present in (0.0, 5.0):
        batch["goal"] = torch.full((4, 7), present)
        found = loss.critic_loss(batch)["target_value"].item()
        assert found == pytest.approx((3 * 0.95 * 0.3 + 1.0) / 4)
