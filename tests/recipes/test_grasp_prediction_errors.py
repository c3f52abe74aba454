"""grasp_prediction=true of recipes/evaluate.py (Table 5)."""

import json

import predictions
import pytest
from evaluate import evaluate
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict.nn import TensorDictSequential

from torchgrasp.errors import ConfigError
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic
from torchgrasp.runs.weights import save_weights

CONDITIONED = ["model.actor.goal_input=true", "model.critic.goal_input=true"]
SILENT = ["model.actor.goal_prediction=false", "model.critic.goal_prediction=false"]


@pytest.fixture
def untrained(composed, tmp_path):
    """Saves the weights of untrained networks with overrides; returns their file."""

    def save(*overrides: str):
        cfg = composed("experiment=smoke", *overrides)
        names = ["actor", "critic"] + ["goal_network"] * bool(cfg.model.actor.goal_input)
        networks = {name: instantiate(cfg.model[name]) for name in names}
        path = tmp_path / "trained" / "weights.safetensors"
        save_weights(path, networks, OmegaConf.to_container(cfg, resolve=True))
        return path

    return save


@pytest.mark.parametrize(
    ("overrides", "networks"),
    [([], {"actor", "critic"}), ([*CONDITIONED, *SILENT], {"goal_network"})],
)
def test_errors_are_measured_where_the_expert_drives(untrained, composed, tmp_path, overrides, networks):
    options = ["episodes=4", "evaluation.num_objects=4", "evaluation.num_envs=2", "env.horizon=20"]
    options += ["objects.num_grasps=100", "collector.num_workers=0", "grasp_prediction=true"]
    summary = evaluate(composed(f"policy={untrained(*overrides)}", *options, recipe="evaluate"))
    (written,) = tmp_path.glob("evaluate/*/summary.json")
    table = json.loads(written.read_text())["grasp_prediction"]
    assert set(table) == networks
    assert table == summary["grasp_prediction"]
    for errors in table.values():
        assert errors["trajectories"] >= 1
        goal, half, known = (
            errors[name]["point_distance_m"]
            for name in ("expert_goal", "expert_goal_or_half_turn", "nearest_known_grasp")
        )
        for number in ("min", "mean"):  # the more candidates there are, the nearer is the nearest
            assert goal[number] + 1e-5 >= half[number] >= known[number] - 1e-5 > 0.0
        assert goal["min"] <= goal["mean"]


def test_who_reads_goals_stands_behind_the_goal_network(untrained):
    predictors = predictions.make_predictors(str(untrained(*CONDITIONED)))
    assert isinstance(predictors["goal_network"], GoalPredictor)
    kinds = {"actor": GraspActor, "critic": GraspCritic}
    for name, kind in kinds.items():
        assert isinstance(predictors[name], TensorDictSequential)
        assert [type(each) for each in predictors[name].module] == [GoalPredictor, kind]
        assert "goal" not in predictors[name].in_keys


def test_a_critic_that_is_told_the_goal_is_left_out(untrained):
    assert set(predictions.make_predictors(str(untrained("model.critic.goal_input=true")))) == {"actor"}


def test_who_predicts_nothing_is_refused(untrained):
    with pytest.raises(ConfigError, match="policy=expert, which predicts no grasps"):
        predictions.make_predictors("expert")
    with pytest.raises(ConfigError, match="predict no goal"):
        predictions.make_predictors(str(untrained(*SILENT)))
