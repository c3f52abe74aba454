"""Actor and critic: the delay between their updates, the targets, and resuming in between."""

import copy

import pytest
import torch

from tests.training.parts import make_actor_critic, make_batch, weights
from torchgrasp.errors import ConfigError


def updates(learner, number, *, first=0):
    """What a recipe does with batches; tells when the actor was updated."""
    updated = []
    for seed in range(first, first + number):
        batch = make_batch(seed=seed)
        learner.update_critic(batch)
        updated.append(learner.actor_is_due)
        if learner.actor_is_due:
            learner.update_actor(batch)
    return updated


@pytest.mark.parametrize("delay", [1, 2, 3])
def test_the_actor_is_due_after_every_so_many_critic_updates(delay):
    learner = make_actor_critic(policy_delay=delay)
    expected = [number % delay == 0 for number in range(1, 7)]
    assert updates(learner, 6) == expected and learner.critic_updates == 6


def test_each_update_changes_its_own_network_alone():
    learner, batch = make_actor_critic(), make_batch()
    before = {name: weights(each) for name, each in learner.networks.items()}
    learner.update_critic(batch)
    changed = {name: not torch.equal(weights(each), before[name]) for name, each in learner.networks.items()}
    assert changed == {"actor": False, "critic": True}
    before = {name: weights(each) for name, each in learner.networks.items()}
    learner.update_actor(batch)
    changed = {name: not torch.equal(weights(each), before[name]) for name, each in learner.networks.items()}
    assert changed == {"actor": True, "critic": False}


def test_terms_are_those_of_equations_3_and_4_and_the_batch_learns_its_error():
    learner, batch = make_actor_critic(policy_delay=1), make_batch()
    learner.update_critic(batch)
    learner.update_actor(batch)
    terms = set(learner.fetch_terms())
    assert {"critic/loss_qvalue", "critic/loss_critic_aux"} <= terms
    assert {"actor/loss_actor_bc", "actor/loss_actor_ddpg", "actor/loss_actor_aux"} <= terms
    assert batch["td_error"].shape[0] == len(batch)


def test_targets_know_what_imitation_has_taught_once_they_are_copied():
    learner, batch = make_actor_critic(), make_batch()
    for _ in range(5):
        learner.imitate(batch)  # no step of the targets
    learner.copy_to_targets()
    learned = learner.loss.actor_network_params
    target = learner.loss.target_actor_network_params
    assert all(torch.equal(value, target.get(key)) for key, value in learned.items(True, True))


def test_a_run_resumed_between_two_updates_of_the_actor_goes_on_alike():
    whole, first, second = make_actor_critic(), make_actor_critic(), make_actor_critic(seed=9)
    told = updates(whole, 6)
    begun = updates(first, 3)  # the critic has had one update since the actor's last
    random = torch.get_rng_state()
    second.load_state_dict(first.state_dict())
    torch.set_rng_state(random)
    assert second.critic_updates == 3
    assert begun + updates(second, 3, first=3) == told == [False, True, False, True, False, True]


def test_the_state_holds_networks_optimizers_and_targets_exactly():
    first, second = make_actor_critic(), make_actor_critic(seed=9)
    updates(first, 5)
    second.load_state_dict(copy.deepcopy(first.state_dict()))  # as from a file: optimizers would share
    for learner in (first, second):
        torch.manual_seed(4)  # of the smoothing noise
        updates(learner, 4, first=5)
    for name in first.networks:
        assert torch.equal(weights(first.networks[name]), weights(second.networks[name]))
    assert torch.equal(weights(first.loss), weights(second.loss))
    assert first.targets.state_dict() == second.targets.state_dict()


def test_an_impossible_delay_is_refused():
    with pytest.raises(ConfigError, match=r"^policy_delay=0 is out of range"):
        make_actor_critic(policy_delay=0)
