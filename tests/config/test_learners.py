"""Learners of every choice: their networks, losses, optimizers and targets."""

import pytest
import torch

from tests.configurations import ROOT
from torchgrasp.config import make_actor_critic, make_imitation_learner
from torchgrasp.errors import ConfigError
from torchgrasp.runs import seed_everything

# 3 and 4 cm, as an action and as a goal.
ACTION = torch.tensor([[0.03, -0.04, 0, 0, 0, 0]])
GOAL = torch.tensor([[0.03, -0.04, 0, 0, 0, 0, 1]])
REST = torch.tensor([[0.0, 0, 0, 0, 0, 0, 1]])
WEIGHTS = {"bc": 1.0, "td3_bc": 0.2, "td3_bc_laptop": 0.98}


def choices(group: str) -> list[str]:
    return sorted(path.stem for path in (ROOT / "conf" / group).glob("*.yaml"))


@pytest.mark.parametrize("experiment", choices("experiment"))
@pytest.mark.parametrize("model", choices("model"))
@pytest.mark.parametrize("loss", choices("loss"))
def test_every_choice_builds(composed, experiment, model, loss):
    given = [f"model={model}", f"loss={loss}", "model.width=0.25"]
    cfg = composed(f"experiment={experiment}", *given)
    corrects = cfg.model.residual is not None
    assert corrects is (experiment in ("demo", "residual"))
    learner = make_actor_critic(cfg, make_imitation_learner(cfg) if corrects else None)
    assert learner.loss.bc_weight == (0.0 if corrects else WEIGHTS[loss])
    assert learner.targets.period == cfg.online.period
    assert learner.policy_delay == cfg.online.policy_delay and learner.critic_updates == 0
    assert set(learner.networks) == set(learner.optimizers) == {"actor", "critic"}


@pytest.mark.parametrize("loss", choices("loss"))
@pytest.mark.parametrize(("overrides", "expected"), [([], 0.07), (["loss.distance.norm=l2"], 0.05)])
def test_the_norm_reaches_every_pose_loss(composed, loss, overrides, expected):
    cfg = composed("experiment=smoke", f"loss={loss}", *overrides)
    learner = make_actor_critic(cfg)
    for each in (learner.loss, learner.imitation, make_imitation_learner(cfg).imitation):
        assert each.distance(ACTION, torch.zeros(1, 6)).item() == pytest.approx(expected)
        assert each.goal_distance(GOAL, REST).item() == pytest.approx(expected)


@pytest.mark.parametrize("make", [make_actor_critic, make_imitation_learner])
def test_a_wrong_norm_is_refused(composed, make):
    with pytest.raises(ConfigError, match="norm='l3' is unknown"):
        make(composed("experiment=smoke", "loss.distance.norm=l3"))


@pytest.mark.parametrize("make", [make_actor_critic, make_imitation_learner])
def test_an_actor_that_reads_goals_has_a_goal_network_beside_it(composed, make):
    conditioned = ["model.actor.goal_input=true", "model.critic.goal_input=true"]
    plain, reading = (make(composed("experiment=smoke", *given)) for given in ([], conditioned))
    assert set(reading.networks) - set(plain.networks) == {"goal_network"}
    assert plain.grasp_prediction is None and reading.grasp_prediction is not None
    assert "goal" in reading.actor.in_keys and "goal" not in reading.policy.in_keys


def test_imitation_alone_builds_no_critic(composed):
    learner = make_imitation_learner(composed("experiment=smoke", recipe="bc"))
    assert set(learner.networks) == {"actor"}


def test_who_predicts_no_goal_learns_none(composed):
    silent = composed("experiment=smoke", "model.actor.goal_prediction=false")
    assert make_imitation_learner(silent).imitation.aux_weight == 0.0
    assert make_imitation_learner(composed("experiment=smoke")).imitation.aux_weight == 1.0


def test_a_seed_fixes_the_first_weights(composed):
    def first(seed):
        seed_everything(seed)
        return torch.cat(
            [p.flatten() for p in make_actor_critic(composed("experiment=smoke")).actor.parameters()]
        )

    assert torch.equal(first(3), first(3)) and not torch.equal(first(3), first(4))


def test_an_impossible_delay_is_refused(composed):
    with pytest.raises(ConfigError, match="policy_delay=0"):
        make_actor_critic(composed("experiment=smoke", "online.policy_delay=0"))
