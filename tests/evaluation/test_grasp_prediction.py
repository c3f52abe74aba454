import math

import pytest
import torch
from tensordict.nn import TensorDictSequential
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.grasp_prediction import (
    GraspPredictionTable,
    find_predictors,
    grasp_errors,
    measure_grasp_prediction,
    nearest_grasp,
    with_half_turn,
)
from torchgrasp.geometry import make_pose
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic, PointNet
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.rollouts import SerialPool
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AppendGripperPoints, DepthToPoints, SamplePoints


def turned(degrees: float, translation=(0.0, 0.0, 0.0)) -> torch.Tensor:
    """A hand turned about its z axis."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    rotation = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    return make_pose(rotation, torch.tensor(translation, dtype=torch.float64))


def test_a_quarter_turn_by_hand():
    errors = grasp_errors(turned(90.0), turned(0.0)[None])
    # A finger at y = 0.053 goes to x = -0.053: 0.106 in L1. Four of the six control points are fingers'.
    assert errors.translation == 0.0
    assert errors.rotation == pytest.approx(90.0)
    assert errors.point_distance == pytest.approx(4 * 0.106 / 6)


def test_a_move_counts_in_euclidean_metres_and_in_l1():
    errors = grasp_errors(turned(0.0, (0.01, -0.02, 0.02)), turned(0.0)[None])
    assert errors.translation == pytest.approx(0.03)
    assert errors.rotation == pytest.approx(0.0, abs=1e-6)
    assert errors.point_distance == pytest.approx(0.05)


def test_errors_are_the_same_in_every_frame():
    T_base_ee = turned(40.0, (0.4, -0.1, 0.3))
    predicted, true = turned(170.0, (0.02, 0.01, 0.1)), turned(-30.0, (0.0, 0.03, 0.1))
    here = grasp_errors(predicted, true[None])
    there = grasp_errors(T_base_ee @ predicted, (T_base_ee @ true)[None])
    # L1 itself depends on the axes.
    torch.testing.assert_close(torch.stack(here[:2]), torch.stack(there[:2]))
    assert here.rotation == pytest.approx(160.0)


def test_the_half_turn_is_the_other_candidate():
    both = with_half_turn(turned(15.0, (0.1, 0.2, 0.3)))
    torch.testing.assert_close(both[1], turned(195.0, (0.1, 0.2, 0.3)))
    assert grasp_errors(turned(180.0), turned(0.0)[None]).rotation == pytest.approx(180.0)
    assert grasp_errors(turned(180.0), with_half_turn(turned(0.0))).rotation == pytest.approx(0.0, abs=1e-5)


def test_the_nearest_is_chosen_for_each_pose():
    grasps = torch.stack([turned(0.0), turned(80.0), turned(0.0, (0.0, 0.0, 0.2))])
    predicted = torch.stack([turned(70.0), turned(3.0, (0.0, 0.0, 0.19)), turned(-10.0)])
    torch.testing.assert_close(nearest_grasp(predicted, grasps), grasps[[1, 2, 0]])


def test_table_averages_the_least_and_the_mean_of_each_trajectory():
    table = GraspPredictionTable()
    goal = turned(0.0)
    # First trajectory 40, 20, 30 degrees off; second 170, which is 10 from the half turn.
    for angles in ([40.0, 20.0, 30.0], [170.0]):
        predicted = torch.stack([turned(angle) for angle in angles])
        goals = goal.expand(len(angles), 4, 4)
        known = torch.stack([goal, turned(25.0)]).expand(len(angles), 2, 4, 4)
        table.add(predicted, goals, known=known)
    summary = table.summary()
    assert table.trajectories == summary["trajectories"] == 2
    rotation = {name: row["rotation_deg"] for name, row in summary.items() if name != "trajectories"}
    assert rotation["expert_goal"] == pytest.approx({"min": (20 + 170) / 2, "mean": (30 + 170) / 2})
    assert rotation["expert_goal_or_half_turn"] == pytest.approx({"min": 15.0, "mean": 20.0})
    # 40, 20 and 30 are 15, 5 and 5 from the grasp at 25; 170 is 145 from it.
    assert rotation["nearest_known_grasp"] == pytest.approx({"min": 75.0, "mean": (25 / 3 + 145) / 2})
    assert summary["expert_goal"]["translation_m"] == {"min": 0.0, "mean": 0.0}


def test_a_perfect_prediction_has_no_error_in_any_reading():
    table = GraspPredictionTable()
    goal = torch.stack([turned(12.0, (0.0, 0.05, 0.1)), turned(-50.0)])
    table.add(goal, goal, known=goal[:, None])
    summary = table.summary()
    for reading in ("expert_goal", "expert_goal_or_half_turn", "nearest_known_grasp"):
        for row in summary[reading].values():
            assert row == pytest.approx({"min": 0.0, "mean": 0.0}, abs=1e-5)


def test_an_empty_table_has_no_numbers():
    assert GraspPredictionTable().summary() == {"trajectories": 0}


def test_who_reads_goals_stands_behind_the_goal_network():
    networks = {
        "actor": GraspActor(PointNet, goal_input=True),
        "critic": GraspCritic(PointNet, goal_input=True),
        "goal_network": GoalPredictor(PointNet),
    }
    predictors = find_predictors(networks)
    assert predictors["goal_network"] is networks["goal_network"]
    for name in ("actor", "critic"):
        assert isinstance(predictors[name], TensorDictSequential)
        assert list(predictors[name].module) == [networks["goal_network"], networks[name]]
        assert "goal" not in predictors[name].in_keys


def test_a_critic_that_is_told_the_goal_is_left_out():
    actor = GraspActor(PointNet)
    predictors = find_predictors({"actor": actor, "critic": GraspCritic(PointNet, goal_input=True)})
    assert predictors == {"actor": actor}


def test_who_predicts_nothing_is_refused():
    with pytest.raises(ConfigError, match="goal_prediction=True"):
        find_predictors({"actor": GraspActor(PointNet, goal_prediction=False)})


def test_the_expert_predicts_its_own_goal():
    """Along the expert's trajectories, from its own goal: no error, and a network's is what it predicts."""
    objects = ProceduralObjects("train", num_objects=2, num_grasps=100)
    transforms = Compose(DepthToPoints(), SamplePoints(16), AppendGripperPoints())
    base = GraspEnv(2, objects=objects, camera=RaycastCamera(CameraIntrinsics(24, 24)), horizon=8, seed=0)
    actor, shown = GraspActor(PointNet), []
    with SerialPool({"test": lambda: TransformedEnv(base, transforms)}) as pool:
        rows = measure_grasp_prediction(
            pool,
            ExpertPolicy(objects, horizon=8),
            objects,
            {"actor": actor, "expert": ExpertPolicy(objects, horizon=8, execute=False)},
            num_episodes=3,
            num_envs=2,
            watch=lambda *told: shown.append(told),
        )
    assert 1 <= rows["actor"]["trajectories"] == rows["expert"]["trajectories"] == len(shown) <= 3
    for reading in ("expert_goal", "expert_goal_or_half_turn", "nearest_known_grasp"):
        row = rows["expert"][reading]
        assert row["translation_m"]["mean"] < 1e-4 and row["rotation_deg"]["mean"] < 0.1
        assert rows["actor"][reading]["translation_m"]["min"] > 0.0
    name, steps, predicted, known = shown[0]
    assert name in objects.names and predicted.shape == (len(steps), 4, 4)
    assert known.shape == (len(steps), 100, 4, 4)
