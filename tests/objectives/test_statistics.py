"""BatchNorm in a loss: each network's statistics move by its own passes alone, and targets have theirs."""

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate


class Normed(nn.Module):
    """A batch norm and dropout before one linear layer, over what is read side by side."""

    def __init__(self, num_inputs, num_outputs):
        super().__init__()
        self.layers = nn.Sequential(
            nn.BatchNorm1d(num_inputs), nn.Dropout(0.5), nn.Linear(num_inputs, num_outputs)
        )
        self.fails, self.modes = False, []

    def forward(self, *inputs):
        self.modes.append((self.layers[0].training, self.layers[1].training))
        if self.fails:
            raise RuntimeError("no pass")
        return self.layers(torch.cat(inputs, dim=-1))


@pytest.fixture
def networks():
    torch.manual_seed(0)
    actor = TensorDictModule(Normed(1, 6), ["time_left"], ["action"])
    critic = TensorDictModule(Normed(7, 2), ["time_left", "action"], ["state_action_value"])
    return actor, critic


def make_loss(networks):
    loss = GraspTD3BCLoss(*networks, action_bound=ACTION_BOUND)
    StaggeredTargetUpdate(loss)
    return loss


def statistics(loss, *names):
    return {
        (name, key): value.clone()
        for name in names
        for key, value in getattr(loss, f"{name}_network_params").items(True, True)
        if key[-1] in ("running_mean", "running_var", "num_batches_tracked")
    }


def moved(before, after):
    return {key[0] for key, value in before.items() if not torch.equal(value, after[key])}


ALL = ("actor", "critic", "target_actor", "target_critic", "target_delayed_critic")


@pytest.mark.parametrize("side", ["actor", "critic"])
def test_a_side_moves_its_own_statistics_alone(networks, batch, side):
    loss = make_loss(networks)
    before = statistics(loss, *ALL)
    assert len(before) == 3 * len(ALL)
    getattr(loss, f"{side}_loss")(batch)
    assert moved(before, statistics(loss, *ALL)) == {side}


def test_targets_use_what_is_stored(networks, batch):
    """The target of a sample does not depend on those beside it; dropout is as the mode has it."""
    loss = make_loss(networks)
    loss.smoothing.policy_noise = 0.0
    for network in networks:
        network.module.layers[1].p = 0.0
    whole = loss._target_value(batch)
    torch.testing.assert_close(loss._target_value(batch[:2]), whole[:2])
    assert loss.critic_network.module.modes == [(False, True)] * 4


def test_modes_come_back_after_an_error(networks, batch):
    loss = make_loss(networks)
    loss.critic_network.module.fails = True
    with pytest.raises(RuntimeError, match="no pass"):
        loss.critic_loss(batch)
    assert all(module.training for module in loss.critic_network.modules())


def test_evaluation_stays_evaluation(networks, batch):
    loss = make_loss(networks)
    loss.eval()
    before = statistics(loss, *ALL)
    loss(batch)
    assert not moved(before, statistics(loss, *ALL))
    assert not any(module.training for module in loss.critic_network.modules())
