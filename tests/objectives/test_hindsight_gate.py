"""Eq. (5): no gradient of L_AUX from an episode that failed, all of it from one that succeeded."""

import pytest
import torch

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.objectives import GoalAuxLoss, GraspTD3BCLoss, StaggeredTargetUpdate


def _terms(kind, constant_actor, constant_critic, *, gated):
    """(computes L_AUX from a batch, the network that predicts the goal)."""
    actor, critic = constant_actor(), constant_critic()
    if kind == "alone":
        loss = GoalAuxLoss(actor, success_only=gated)
        return lambda batch: loss(batch)["loss_aux"], actor
    loss = GraspTD3BCLoss(actor, critic, hindsight=gated, action_bound=ACTION_BOUND)
    StaggeredTargetUpdate(loss)
    if kind == "actor":
        return lambda batch: loss.actor_loss(batch)["loss_actor_aux"], actor
    return lambda batch: loss.critic_loss(batch)["loss_critic_aux"], critic


def _gradient(term, network):
    found = torch.autograd.grad(term, list(network.parameters()), allow_unused=True)
    return [torch.zeros_like(p) if g is None else g for g, p in zip(found, network.parameters(), strict=True)]


@pytest.fixture(params=["actor", "critic", "alone"])
def side(request, constant_actor, constant_critic):
    """L_AUX with and without the gate, each with its network."""
    return [_terms(request.param, constant_actor, constant_critic, gated=gated) for gated in (True, False)]


def _outcome(batch, success):
    return batch.clone().set("episode_success", torch.tensor(success).reshape(4, 1))


def test_failed_episodes_give_no_gradient_at_all(side, batch):
    (gated, network), _ = side
    term = gated(_outcome(batch, [False] * 4))
    assert term.item() == 0.0
    assert all(torch.equal(g, torch.zeros_like(g)) for g in _gradient(term, network))


def test_successful_episodes_give_the_whole_gradient(side, batch):
    (gated, network), (plain, other) = side
    term, expected = gated(_outcome(batch, [True] * 4)), plain(batch)
    assert torch.equal(term, expected)
    found = _gradient(term, network)
    assert any(g.any() for g in found)
    assert all(torch.equal(a, b) for a, b in zip(found, _gradient(expected, other), strict=True))


def test_a_failure_beside_a_success_only_dilutes_it(side, batch):
    """Samples 0 and 2 have goals, 0 succeeded: half the gradient of sample 0 alone."""
    (gated, network), _ = side
    both = _gradient(gated(_outcome(batch, [True, True, False, False])), network)
    alone = _gradient(gated(_outcome(batch, [True] * 4)[:1]), network)
    for a, b in zip(both, alone, strict=True):
        torch.testing.assert_close(a, 0.5 * b)


def test_the_goal_of_a_failed_episode_is_never_read(side, batch):
    (gated, network), _ = side
    failed = _outcome(batch, [True, True, False, False])
    expected = gated(failed)
    failed["goal"][2] = torch.nan
    found = gated(failed)
    assert torch.equal(found, expected)
    assert all(g.isfinite().all() for g in _gradient(found, network))


def test_other_terms_do_not_pass_the_gate(constant_actor, constant_critic, batch):
    """Imitation and reinforcement learn from failures too."""
    outs = []
    for success in ([True] * 4, [False] * 4):
        loss = GraspTD3BCLoss(
            constant_actor(),
            constant_critic((0.4, 0.2)),
            hindsight=True,
            policy_noise=0.0,
            action_bound=ACTION_BOUND,
        )
        StaggeredTargetUpdate(loss)
        outs.append(loss(_outcome(batch, success)))
    for key in ("loss_qvalue", "loss_actor_bc", "loss_actor_ddpg"):
        assert torch.equal(outs[0][key], outs[1][key])
