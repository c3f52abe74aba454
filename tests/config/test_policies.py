"""Policies by name, or from trained weights."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential

from torchgrasp.config import evaluation_config, make_policy
from torchgrasp.config.networks import rebuild_acting
from torchgrasp.config.weights_files import read_trained
from torchgrasp.errors import ConfigError
from torchgrasp.modules import GoalPredictor, GraspActor
from torchgrasp.planning import ExpertPolicy, OpenLoopPolicy, RandomAction, Relay

SMALL = ["objects.num_objects=4", "evaluation.num_objects=4", "objects.num_grasps=100"]


@pytest.fixture
def configured(composed):
    return lambda *overrides: evaluation_config(composed(*overrides, *SMALL, recipe="evaluate"))


def test_the_expert_and_chance(configured):
    expert = make_policy(configured("policy=expert", "env.horizon=17"), "expert")
    assert isinstance(expert, ExpertPolicy) and expert.horizon == 17
    assert isinstance(make_policy(configured("policy=random"), "random"), RandomAction)


def test_planning_is_configured_by_its_group(configured):
    made = {}
    for planning in ("perfect", "noisy"):
        cfg = configured("policy=planning", f"planning={planning}", "planning.steps=22")
        made[planning] = make_policy(cfg, "planning")
        assert isinstance(made[planning], OpenLoopPolicy) and made[planning].steps == 22
    assert made["perfect"].pose_noise is None
    noise = made["noisy"].pose_noise
    assert noise.translation == 0.01 and noise.rotation == pytest.approx(5 * torch.pi / 180, rel=1e-3)


def test_a_learner_brings_its_horizon_and_transforms_into_a_relay(configured, untrained):
    learner = untrained("env.horizon=28", "transforms.sample.num_points=48")
    for policy, steps in (("combined", (20, 20)), ("takeover", (0, 25))):
        cfg = configured(f"policy={policy}", f"learner={learner}")
        assert cfg.env.horizon == 28 and cfg.transforms.sample.num_points == 48
        relay = make_policy(cfg, policy)
        assert isinstance(relay, Relay) and (relay.low, relay.high) == steps
        planned, learned = (relay.first, relay.second)[:: 1 if policy == "combined" else -1]
        assert isinstance(planned, OpenLoopPolicy if policy == "combined" else ExpertPolicy)
        assert planned.horizon == 28 and learned.state_dict()


def test_a_goal_network_acts_before_its_actor(configured, untrained):
    learner = untrained("model.actor.goal_input=true", "model.critic.goal_input=true")
    policy = make_policy(configured(f"policy={learner}"), str(learner))
    assert isinstance(policy, TensorDictSequential)
    assert [type(each) for each in policy.module] == [GoalPredictor, GraspActor]
    networks = rebuild_acting(read_trained(learner))
    assert set(networks) == {"actor", "goal_network"}
    seen = TensorDict({"points": torch.rand(2, 38, 4), "time_left": torch.ones(2, 1)}, [2])
    by_hand = networks["actor"](networks["goal_network"](seen.clone()))
    assert torch.equal(policy(seen)["action"], by_hand["action"])


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["policy=planning", "planning.steps=31"], "planning.steps=31"),
        (["policy=planning", "env.horizon=20"], "horizon=20"),
        (["policy=planning", "planning.steps=0"], "planning.steps=0"),
        (["policy=planning", "planning=noisy", "planning.pose_noise.translation=-1"], "translation=-1"),
        (["policy=combined", "learner=random", "combined.steps=31"], "combined.steps=31"),
        (["policy=takeover", "learner=random", "takeover.steps=[5,40]"], "takeover.steps=[5, 40]"),
    ],
)
def test_what_cannot_be_is_refused_by_name(configured, overrides, told):
    cfg = configured(*overrides)
    with pytest.raises(ConfigError) as raised:
        make_policy(cfg, str(cfg.policy))
    assert told in str(raised.value)
