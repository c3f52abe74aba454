"""Disturbances and the expert's share of an episode."""

import math

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.errors import ConfigError
from torchgrasp.planning import Disturb, ExpertStart

HORIZON = 20


def episodes(worlds: int, numbers: int) -> TensorDict:
    """(worlds, numbers, HORIZON) steps of idle episodes."""
    shape = (worlds, numbers, HORIZON)
    time_left = (1 - torch.arange(HORIZON) / HORIZON).expand(shape)
    world = torch.arange(worlds)[:, None, None].expand(shape)
    number = torch.arange(numbers)[None, :, None].expand(shape)
    return TensorDict(
        {
            "action": torch.zeros(*shape, 6),
            "expert_action": torch.ones(*shape, 6),
            "has_expert": torch.ones(*shape, 1, dtype=torch.bool),
            "time_left": time_left[..., None].clone(),
            "world": world[..., None].clone(),
            "episode": number[..., None].clone(),
        },
        shape,
    )


def test_disturbances_come_as_often_and_as_large_as_asked():
    steps = Disturb(probability=0.3, translation=0.03, rotation=0.14, until=0.0)(episodes(20, 20))
    hit = steps["perturbed"][..., 0]
    n = hit[..., 1:].numel()
    assert hit.float().mean() == pytest.approx(0.3, abs=4 * math.sqrt(0.21 / n))
    noise = steps["action"][hit]
    assert noise[:, :3].abs().max() <= 0.03 and noise[:, 3:].abs().max() <= 0.14
    assert noise[:, :3].abs().max() > 0.029 and noise[:, 3:].abs().max() > 0.13
    assert noise.mean(0).abs().max() < 0.01


def test_what_is_flagged_is_what_was_disturbed():
    steps = Disturb()(episodes(5, 5))
    assert torch.equal(steps["action"].any(-1, keepdim=True), steps["perturbed"])
    assert steps["perturbed"].dtype == torch.bool
    assert torch.equal(steps["expert_action"], torch.ones_like(steps["expert_action"]))


def test_there_is_no_disturbance_near_the_end():
    steps = Disturb(probability=1.0, until=0.25)(episodes(2, 2))
    late = steps["time_left"] <= 0.25
    assert not steps["perturbed"][late].any() and steps["perturbed"][~late].all()


@pytest.mark.parametrize("probability, share", [(0.0, 0.0), (1.0, 1.0)])
def test_never_and_always(probability, share):
    steps = Disturb(probability=probability, until=0.0)(episodes(3, 3))
    assert steps["perturbed"].float().mean() == share


@pytest.mark.parametrize(
    "make", [lambda: Disturb(seed=3), lambda: ExpertStart(horizon=HORIZON, seed=3)], ids=["disturb", "start"]
)
def test_draws_belong_to_their_moment_whatever_the_batch(make):
    whole = make()(episodes(4, 4))
    part = make()(episodes(4, 4)[2:, 1])
    assert torch.equal(part["action"], whole["action"][2:, 1])
    used = make()
    used(episodes(3, 2))
    step = used(episodes(4, 4)[3, 3, 7])
    assert torch.equal(step["action"], whole["action"][3, 3, 7])


def test_the_expert_begins_some_episodes_and_the_learner_ends_all():
    start = ExpertStart(horizon=HORIZON, probability=0.5, max_steps=10)
    turn = start(episodes(30, 30))["action"][..., 0] == 1.0
    lengths = turn.sum(-1)
    # The expert's steps are the first ones, without a gap.
    assert torch.equal(turn, torch.arange(HORIZON) < lengths[..., None])
    begun = lengths > 0
    assert begun.float().mean() == pytest.approx(0.5, abs=0.07)
    assert lengths[begun].min() == 1 and lengths[begun].max() == 10
    assert lengths[begun].float().mean() == pytest.approx(5.5, abs=0.6)


def test_without_a_plan_the_learner_acts():
    steps = episodes(2, 2)
    steps["has_expert"][:] = False
    assert not ExpertStart(horizon=HORIZON, probability=1.0)(steps)["action"].any()


def test_other_seeds_choose_other_episodes():
    chosen = [ExpertStart(horizon=HORIZON, seed=seed)(episodes(10, 10))["action"] for seed in (0, 1)]
    assert not torch.equal(*chosen)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Disturb(probability=1.5),
        lambda: Disturb(until=-0.1),
        lambda: ExpertStart(horizon=10, max_steps=11),
        lambda: ExpertStart(horizon=10, probability=-1.0),
    ],
)
def test_impossible_numbers_are_refused(make):
    with pytest.raises(ConfigError):
        make()
