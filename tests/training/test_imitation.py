"""Imitation: which network learns from what, and that a learner goes on as if it had not stopped."""

import pytest
import torch

from tests.training.parts import make_batch, make_imitation_learner, weights
from torchgrasp.objectives import PoseBCLoss
from torchgrasp.training import ImitationLearner


def test_updates_bring_the_action_nearer_to_the_label():
    learner, batch = make_imitation_learner(), make_batch()
    losses = []
    for _ in range(30):
        learner.imitate(batch)
        losses.append(learner.fetch_terms()["actor/loss_bc"])
    assert losses[-1] < 0.5 * losses[0]


def test_a_rate_of_zero_leaves_all_as_it_is():
    learner = make_imitation_learner(goal_input=True)
    before = {name: weights(each) for name, each in learner.networks.items()}
    learner.set_rate(0.0)
    learner.imitate(make_batch())
    assert all(torch.equal(weights(each), before[name]) for name, each in learner.networks.items())
    learner.set_rate(1e-3)
    learner.imitate(make_batch())
    assert not any(torch.equal(weights(each), before[name]) for name, each in learner.networks.items())


def test_further_networks_are_kept_and_saved_but_not_trained():
    learner, critic = make_imitation_learner(), torch.nn.Linear(2, 2)
    actor = learner.actor
    adams = {**learner.optimizers, "critic": torch.optim.Adam(critic.parameters(), lr=1.0)}
    both = ImitationLearner({"actor": actor, "critic": critic}, imitation=PoseBCLoss(actor), optimizers=adams)
    before = weights(critic)
    both.imitate(make_batch())
    assert torch.equal(weights(critic), before) and set(both.state_dict()["networks"]) == {"actor", "critic"}


def test_where_the_actor_reads_goals_the_policy_predicts_them_first():
    plain, reading = make_imitation_learner(), make_imitation_learner(goal_input=True)
    assert plain.policy is plain.actor
    assert "goal" in reading.actor.in_keys and "goal" not in reading.policy.in_keys
    reading.imitate(make_batch())
    assert {"actor/loss_bc", "goal_network/loss_aux"} <= set(reading.fetch_terms())


@pytest.mark.parametrize("goal_input", [False, True])
def test_a_resumed_learner_goes_on_as_if_it_had_not_stopped(goal_input):
    whole = make_imitation_learner(goal_input=goal_input)
    for seed in range(3):
        whole.imitate(make_batch(seed=seed))
    first = make_imitation_learner(goal_input=goal_input)
    first.imitate(make_batch(seed=0))
    second = make_imitation_learner(goal_input=goal_input, seed=9)
    second.load_state_dict(first.state_dict())
    for seed in (1, 2):
        second.imitate(make_batch(seed=seed))
    for name, network in whole.networks.items():
        assert torch.equal(weights(network), weights(second.networks[name]))
    assert whole.fetch_terms() == second.fetch_terms()  # the mean over all three updates


def test_a_state_of_other_networks_is_refused():
    with pytest.raises((KeyError, RuntimeError)):
        make_imitation_learner(goal_input=True).load_state_dict(make_imitation_learner().state_dict())
