"""recipes/evaluate.py: success, films, failures, relays, grasp prediction (Tables 5 and 6), and its page."""

import json

import pytest
from omegaconf import OmegaConf

from recipes.evaluate import evaluate
from tests.recipes.runner import find_run
from torchgrasp.config.networks import make_networks
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import save_weights

SMALL = ["objects.num_objects=4", "evaluation.num_objects=4", "objects.num_grasps=100"]
SMALL += ["evaluation.num_envs=2", "collector.num_workers=0"]
CONDITIONED = ["model.actor.goal_input=true", "model.critic.goal_input=true"]
SILENT = ["model.actor.goal_prediction=false", "model.critic.goal_prediction=false"]


@pytest.fixture
def untrained(composed, tmp_path):
    """Saves the weights of untrained networks with overrides; returns their file."""

    def save(*overrides: str):
        cfg = composed("experiment=smoke", "env.horizon=28", *overrides)
        path = tmp_path / "trained" / "weights.safetensors"
        save_weights(path, make_networks(cfg.model), OmegaConf.to_container(cfg, resolve=True))
        return path

    return save


@pytest.fixture
def run_evaluate(composed):
    return lambda *overrides: evaluate(composed(*SMALL, *overrides, recipe="evaluate"))


def read_summary(tmp_path) -> dict:
    return json.loads((find_run(tmp_path, "evaluate") / "summary.json").read_text())


def test_a_trained_policy_brings_its_parts_along_and_does_what_it_did_at_the_end(
    run_evaluate, trained, capsys
):
    run_dir, summary = trained
    again = run_evaluate(f"policy={run_dir}", "episodes=4")
    assert again["objects"] == summary["objects"]
    assert again["env_steps"] == summary["comparison"]["policy"]["env_steps"]
    assert "4 scenes of the test split" in capsys.readouterr().out


def test_who_names_no_engine_evaluates_in_that_of_configurations_without_one(run_evaluate):
    summary = run_evaluate("policy=random", "episodes=2", "~engine")
    assert summary["engine"] == "torchgrasp.sim.SapienEngine"


def test_a_critic_says_what_it_thinks_of_the_policy(run_evaluate, untrained, tmp_path, capsys):
    run_evaluate(f"policy={untrained()}", "episodes=4", "value_quality=0.95")
    told = read_summary(tmp_path)["value_quality"]
    assert told["episodes"] == 4 and {"25", "10", "1"} < set(told["steps_left"])  # of 28 steps
    assert "The critic's values in 4 episodes, by steps left" in capsys.readouterr().out


def test_a_critic_that_alone_reads_the_goal_is_refused(run_evaluate, untrained):
    file = untrained("model.critic.goal_input=true")
    with pytest.raises(ConfigError, match="whose critic alone reads the goal"):
        run_evaluate(f"policy={file}", "episodes=4", "value_quality=0.95")


def test_who_has_no_critic_is_told(run_evaluate):
    with pytest.raises(ConfigError, match=r"value_quality=1\.0 with policy=expert, which has no critic"):
        run_evaluate("policy=expert", "value_quality=1.0")


@pytest.mark.slow
def test_films_of_the_first_episodes_are_written(run_evaluate, tmp_path):
    run_evaluate("policy=random", "episodes=3", "env.horizon=3", "video.episodes=2")
    films = sorted(path.name for path in find_run(tmp_path, "evaluate").glob("videos/*.mp4"))
    assert len(films) == 2 and films[0].startswith("000_") and films[1].startswith("001_")


def test_the_page_shows_failures_and_the_options_that_matter(run_evaluate, tmp_path):
    run_evaluate("policy=random", "episodes=4", "evaluation.num_objects=3", "env.horizon=3")
    run_dir = find_run(tmp_path, "evaluate")
    text = (run_dir / "report.html").read_text()
    assert "<td>evaluation.num_objects</td><td>3</td>" in text
    assert "<td>camera</td><td>RaycastCamera</td>" in text
    assert text.count("data:image/png") == 4 and not (run_dir / "videos").exists()


def test_takeover_reports_by_the_learners_steps(run_evaluate, tmp_path, untrained, capsys):
    learner = untrained()
    run_evaluate("policy=takeover", f"learner={learner}", "episodes=5")
    summary, out = read_summary(tmp_path), capsys.readouterr().out
    bins = summary["learner_steps"]
    assert set(bins) <= {"0-5", "6-10", "11-15", "16-20", "21-25"}
    assert sum(row["episodes"] for row in bins.values()) == 5
    assert all(name in out for name in bins)
    assert summary["learner"] == str(learner)


def test_planning_and_combined_work_in_other_protocols(run_evaluate, tmp_path, untrained, capsys):
    given = ["policy=combined", f"learner={untrained()}", "protocol=handover", "planning=noisy"]
    run_evaluate(*given, "episodes=3")
    summary, out = read_summary(tmp_path), capsys.readouterr().out
    failed = {name for name, row in summary["objects"].items() if row["successes"] < row["episodes"]}
    assert all(name in out for name in failed)
    assert sum(sum(row["failures"].values()) for row in summary["objects"].values()) == sum(
        summary["failures"].values()
    )


@pytest.mark.parametrize(
    ("overrides", "networks"),
    [([], {"actor", "critic"}), ([*CONDITIONED, *SILENT], {"goal_network"})],
)
@pytest.mark.slow
def test_errors_are_measured_where_the_expert_drives(run_evaluate, untrained, tmp_path, overrides, networks):
    given = [f"policy={untrained(*overrides)}", "episodes=4", "env.horizon=20", "grasp_prediction=true"]
    summary = run_evaluate(*given)
    table = read_summary(tmp_path)["grasp_prediction"]
    assert set(table) == networks and table == summary["grasp_prediction"]
    for errors in table.values():
        assert errors["trajectories"] >= 1
        goal, half, known = (
            errors[name]["point_distance_m"]
            for name in ("expert_goal", "expert_goal_or_half_turn", "nearest_known_grasp")
        )
        for number in ("min", "mean"):  # the more candidates there are, the nearer is the nearest
            assert goal[number] + 1e-5 >= half[number] >= known[number] - 1e-5 > 0.0
        assert goal["min"] <= goal["mean"]


def test_the_pretrained_policy_lifts_most_objects_of_the_test_split(composed):
    """Its measured rate is above 90 %; chance that such a policy lifts fewer than 14 of 21 is below 1e-3."""
    given = ["policy=pretrained", "episodes=21", "evaluation.num_objects=8", "collector.num_workers=1"]
    summary = evaluate(composed(*given, recipe="evaluate"))
    assert summary["episodes"] == 21 and summary["success_rate"] > 0.66


def test_truncated_weights_are_named(run_evaluate, tmp_path):
    (tmp_path / "weights.safetensors").write_bytes(b"half")
    with pytest.raises(CheckpointError, match=r"weights\.safetensors is damaged"):
        run_evaluate(f"policy={tmp_path}/weights.safetensors", "episodes=1")
