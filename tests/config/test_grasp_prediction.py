"""Who predicts grasps in an evaluation (Table 5)."""

import pytest
from omegaconf import OmegaConf
from tensordict.nn import TensorDictSequential

from torchgrasp.config import make_predictors
from torchgrasp.errors import ConfigError
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic

CFG = OmegaConf.create({"trust": []})
CONDITIONED = ["model.actor.goal_input=true", "model.critic.goal_input=true"]
SILENT = ["model.actor.goal_prediction=false", "model.critic.goal_prediction=false"]


def test_actor_and_critic_predict_the_goal(untrained):
    predictors = make_predictors(CFG, str(untrained()))
    assert {name: type(each) for name, each in predictors.items()} == {
        "actor": GraspActor,
        "critic": GraspCritic,
    }
    assert set(make_predictors(CFG, str(untrained(recipe="bc")))) == {"actor"}


def test_who_reads_goals_stands_behind_the_goal_network(untrained):
    predictors = make_predictors(CFG, str(untrained(*CONDITIONED)))
    assert isinstance(predictors["goal_network"], GoalPredictor)
    for name, kind in {"actor": GraspActor, "critic": GraspCritic}.items():
        assert isinstance(predictors[name], TensorDictSequential)
        assert [type(each) for each in predictors[name].module] == [GoalPredictor, kind]
        assert "goal" not in predictors[name].in_keys


def test_a_critic_that_is_told_the_goal_is_left_out(untrained):
    assert set(make_predictors(CFG, str(untrained("model.critic.goal_input=true")))) == {"actor"}


def test_who_predicts_nothing_is_refused(untrained):
    with pytest.raises(ConfigError, match="policy=expert, which predicts no grasps"):
        make_predictors(CFG, "expert")
    with pytest.raises(ConfigError, match="predict no goal"):
        make_predictors(CFG, str(untrained(*SILENT)))
