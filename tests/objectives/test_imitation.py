"""PoseBCLoss and GoalAuxLoss: which samples count, keys, reductions, dispatch."""

import pytest
import torch
from tensordict.nn import TensorDictModule

from torchgrasp.errors import ConfigError
from torchgrasp.objectives import GoalAuxLoss, PoseBCLoss


def test_only_labelled_samples_count(constant_actor, batch):
    """Labels 1 and 2 cm away: their mean is 1.5 cm."""
    assert PoseBCLoss(constant_actor())(batch)["loss_bc"].item() == pytest.approx(0.015)


def test_without_a_mask_every_sample_counts(constant_actor, batch):
    assert PoseBCLoss(constant_actor())(batch.exclude("has_expert"))["loss_bc"].item() == pytest.approx(0.025)


def test_without_labels_the_loss_is_zero_and_differentiable(constant_actor, batch):
    actor = constant_actor()
    loss = PoseBCLoss(actor)(batch.set("has_expert", torch.zeros(4, 1, dtype=torch.bool)))["loss_bc"]
    loss.backward()
    assert loss.item() == 0.0
    assert all(p.grad is None or not p.grad.any() for p in actor.parameters())


def test_goals_count_where_there_are_some(constant_actor, batch):
    """Goals 2 and 6 cm away."""
    assert GoalAuxLoss(constant_actor())(batch)["loss_aux"].item() == pytest.approx(0.04)


def test_success_multiplies_the_goal_term(constant_actor, constant_critic, batch):
    """Eq. (5): of the two samples with goals, one episode failed: (2 + 0) / 2 cm."""
    for network in (constant_actor(), constant_critic()):
        loss = GoalAuxLoss(network, success_only=True)
        assert loss(batch)["loss_aux"].item() == pytest.approx(0.01)


def test_both_terms_from_one_pass(constant_actor, batch):
    passes = []
    actor = constant_actor()
    actor.module.register_forward_hook(lambda *_: passes.append(1))
    loss = PoseBCLoss(actor, aux_weight=0.5)
    out = loss(batch)
    assert out["loss_bc"].item() == pytest.approx(0.015)
    assert out["loss_aux"].item() == pytest.approx(0.02)
    assert len(passes) == 1
    assert loss.out_keys == ["loss_bc", "loss_aux"]


@pytest.mark.parametrize(("reduction", "expected"), [("sum", 0.03), ("none", [0.01, 0.02, 0.0, 0.0])])
def test_reductions(constant_actor, batch, reduction, expected):
    found = PoseBCLoss(constant_actor(), reduction=reduction)(batch)["loss_bc"]
    torch.testing.assert_close(found, torch.tensor(expected))


def test_weights_of_prioritised_replay(constant_actor, batch):
    """Weights 1 and 3 on 1 and 2 cm: 7 / 4 cm."""
    batch.set("priority_weight", torch.tensor([1.0, 3.0, 9.0, 9.0]))
    assert PoseBCLoss(constant_actor())(batch)["loss_bc"].item() == pytest.approx(0.0175)


def test_another_distance(constant_actor, batch):
    loss = PoseBCLoss(constant_actor(), distance=lambda a, b: (a - b).square().sum(dim=-1))
    assert loss(batch)["loss_bc"].item() == pytest.approx(2.5e-4)


def test_every_key_can_be_set(constant_actor, batch):
    names = {"expert_action": "label", "has_expert": ("mask", "label"), "action": "move"}
    renamed = batch.clone()
    for old, new in (("expert_action", "label"), ("has_expert", ("mask", "label"))):
        renamed.rename_key_(old, new)
    actor = TensorDictModule(
        constant_actor().module, in_keys=["time_left"], out_keys=["move", "goal_prediction"]
    )
    loss = PoseBCLoss(actor)
    loss.set_keys(**names)
    assert loss(renamed)["loss_bc"].item() == pytest.approx(0.015)
    assert ("mask", "label") in loss.in_keys


def test_dispatch(constant_actor, batch):
    loss = PoseBCLoss(constant_actor(), aux_weight=1.0)
    named = {"time_left": batch["time_left"], "expert_action": batch["expert_action"], "goal": batch["goal"]}
    bc, aux = loss(**named)
    assert bc.item() == pytest.approx(0.025)
    assert aux.item() == pytest.approx(0.05)


def test_time_dimensions(constant_actor, batch):
    twice = torch.stack((batch, batch), dim=1)
    assert PoseBCLoss(constant_actor())(twice)["loss_bc"].item() == pytest.approx(0.015)


def test_modes_reach_the_network(constant_actor):
    loss = PoseBCLoss(constant_actor())
    loss.eval()
    assert not loss.actor_network.module.training
    loss.train()
    assert loss.actor_network.module.training


@pytest.mark.parametrize("make", [PoseBCLoss, GoalAuxLoss])
def test_missing_labels_and_wrong_options_say_what_to_do(constant_actor, batch, make):
    with pytest.raises(ConfigError, match="set_keys"):
        make(constant_actor())(batch.select("time_left"))
    with pytest.raises(ConfigError, match="average"):
        make(constant_actor(), reduction="average")
