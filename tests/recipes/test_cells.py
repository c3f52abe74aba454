"""Cells of the paper's tables as whole runs: what they store, train, write, and read back."""

import functools

import pytest

from recipes import collect, td3_bc
from recipes.evaluate import evaluate
from tests.recipes.runner import find_run, read_metrics, stored_rows
from torchgrasp.runs import load_weights

slow = functools.partial(pytest.param, marks=pytest.mark.slow)
SHORT = ["evaluation.baselines=[]", "evaluation.episodes=2"]
EVALUATED = ["episodes=2", "evaluation.num_objects=4", "evaluation.num_envs=2", "objects.num_grasps=100"]
EVALUATED += ["collector.num_workers=0"]
DEPTH = ["transforms.image.channels=dm", "model.channels=2", "model.encoder.rgb=false"]
COLOUR = ["camera=render"]


@pytest.mark.slow
def test_offline_learns_from_successes_and_from_failures_without_labels(composed, tmp_path):
    cell = ["experiment=[smoke,table3/offline]", "offline.updates=5", *SHORT]
    summary = td3_bc.train(composed(*cell))
    assert summary["env_steps"] == 0 and summary["gradient_steps"] == 6 + 5
    assert summary["demonstrations"]["kind"] == "perturbed"
    assert summary["more_demonstrations"]["failed"]["successes"] == 0
    assert summary["more_demonstrations"]["failed"]["steps"] >= 96
    run_dir = find_run(tmp_path, "td3_bc")
    failed, expert = (stored_rows(run_dir, name) for name in ("failed", "expert"))
    assert not failed["episode_success"].any() and expert["episode_success"].all()
    assert not failed["has_expert"].any() and not failed["has_goal"].any()
    assert expert["has_expert"].float().mean() > 0.5


@pytest.mark.slow
def test_a_folder_of_kinds_is_learned_from(composed, tmp_path):
    for kind in ("expert", "failed"):
        path = f"demonstrations.path={tmp_path / 'kinds' / kind}"
        collect.run(
            composed("experiment=smoke", f"demonstrations.kind={kind}", "demonstrations.steps=12", path)
        )
    kinds = f"demonstrations.path={tmp_path / 'kinds'}"
    summary = td3_bc.train(composed("experiment=smoke", kinds, "total_env_steps=0", *SHORT))
    assert summary["demonstrations"]["kind"] == "expert" and "failed" in summary["more_demonstrations"]


@pytest.mark.slow
def test_without_dagger_the_learners_steps_keep_goals_but_no_expert(composed, tmp_path):
    td3_bc.train(composed("experiment=[smoke,table3/no_dagger]", "total_env_steps=12", *SHORT))
    rows = stored_rows(find_run(tmp_path, "td3_bc"), "online")
    assert not rows["has_expert"].any() and rows["has_goal"].float().mean() > 0.5


@pytest.mark.parametrize(
    ("overrides", "networks", "auxiliary"),
    [
        (["experiment=[smoke,table2/goal_conditioned]"], {"actor", "critic", "goal_network"}, set()),
        slow(["experiment=smoke", "model.critic.goal_input=true"], {"actor", "critic"}, {"actor", "critic"}),
        slow(
            ["experiment=smoke", "model.actor.goal_input=true", "model.critic.goal_prediction=false"],
            {"actor", "critic", "goal_network"},
            {"actor"},
        ),
    ],
    ids=["both read", "the critic reads", "the actor reads"],
)
def test_goals_read_or_predicted(composed, tmp_path, overrides, networks, auxiliary):
    summary = td3_bc.train(composed(*overrides, *SHORT, "total_env_steps=24"))
    assert summary["gradient_steps"] == 6 + 2 * 3
    run_dir = find_run(tmp_path, "td3_bc")
    columns = set(read_metrics(run_dir)[0])
    for name in ("actor", "critic"):
        assert (f"{name}/loss_{name}_aux" in columns) is (name in auxiliary)
    assert ("goal_network/loss_aux" in columns) is ("goal_network" in networks)
    assert set(load_weights(run_dir / "weights.safetensors")[0]) == networks
    again = evaluate(composed(f"policy={run_dir}", *EVALUATED, recipe="evaluate"))
    assert again["env_steps"] == summary["comparison"]["policy"]["env_steps"]
    assert again["objects"] == summary["objects"]


@pytest.mark.parametrize(
    "chosen", [DEPTH, pytest.param(COLOUR, marks=pytest.mark.vulkan)], ids=["dm", "rgbd"]
)
@pytest.mark.slow
def test_images_train_and_come_back(composed, tmp_path, chosen):
    given = ["experiment=smoke", "model=resnet18", "model.width=0.25", "replay=images", "transforms=rgbd"]
    given += ["transforms.image.size=32", "total_env_steps=12", *SHORT]
    summary = td3_bc.train(composed(*given, *chosen))
    assert summary["gradient_steps"] >= 6 and summary["env_steps"] >= 12
    run_dir = find_run(tmp_path, "td3_bc")
    again = evaluate(composed(f"policy={run_dir}", *EVALUATED, recipe="evaluate"))
    assert again["objects"] == summary["objects"]
