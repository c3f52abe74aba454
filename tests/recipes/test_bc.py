"""recipes/bc.py: who acts, what is learned from, and that no critic is there."""

import bc
import pytest
import td3_bc
import torch
from evaluate import evaluate
from omegaconf import OmegaConf

from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs.checkpoint import load_checkpoint
from torchgrasp.runs.weights import load_weights

SHORT = ["evaluation.baselines=[]", "evaluation.episodes=2"]


def find_run(root, recipe="bc"):
    (run_dir,) = root.glob(f"{recipe}/*")
    return run_dir


def stored_rows(run_dir, source):
    """What the checkpoint's buffer holds of a source."""
    return load_checkpoint(run_dir / "checkpoint")["buffer"]["_storage"]["rows"][source]


def test_offline_learns_from_demonstrations_alone_and_without_a_critic(composed, tmp_path):
    summary = bc.train(composed("experiment=[smoke,table1/offline]", *SHORT, recipe="bc"))
    assert summary["env_steps"] == 0
    # 6 updates first, then as many as 48 steps in iterations of 12 bring, 3 each.
    assert summary["gradient_steps"] == 6 + 4 * 3
    assert set(summary["comparison"]) == {"policy", "policy after imitation alone"}
    assert set(load_weights(find_run(tmp_path) / "weights.safetensors")[0]) == {"actor"}
    assert (find_run(tmp_path) / "report.html").exists()


def test_policies_of_imitation_are_evaluated_and_begin_reinforcement(composed, tmp_path):
    cell = ["experiment=[smoke,table1/dagger_aux]", "total_env_steps=12", *SHORT]
    summary = bc.train(composed(*cell, recipe="bc"))
    assert summary["gradient_steps"] == 6 + 3 and summary["env_steps"] >= 12
    run_dir = find_run(tmp_path)
    options = ["episodes=2", "evaluation.num_objects=4", "evaluation.num_envs=2", "objects.num_grasps=100"]
    options += ["grasp_prediction=true", "collector.num_workers=0"]
    again = evaluate(composed(f"policy={run_dir}", *options, recipe="evaluate"))
    assert again["env_steps"] == summary["comparison"]["policy"]["env_steps"]
    assert set(again["grasp_prediction"]) == {"actor"}
    given = [f"init={run_dir}", "total_env_steps=0", "pretrain.steps=0"]
    td3_bc.train(composed("experiment=smoke", *given, *SHORT))
    before = load_weights(run_dir / "weights.safetensors")[0]["actor"]
    after = load_weights(find_run(tmp_path, "td3_bc") / "weights.safetensors")[0]["actor"]
    assert all(torch.equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("rollouts", ["expert", "learner"])
def test_who_acts_and_who_labels(composed, tmp_path, rollouts):
    chosen = [f"online.rollouts=[{rollouts}]", "demonstrations.kind=expert", "total_env_steps=24"]
    bc.train(composed("experiment=smoke", *chosen, "env.horizon=12", *SHORT, recipe="bc"))
    rows = stored_rows(find_run(tmp_path), "online")
    label, acted = rows["expert_action"], rows["action"]
    known = rows["has_expert"].squeeze(-1)
    assert known.float().mean() > 0.5
    same = (label == acted).all(-1)[known]
    assert bool(same.all()) is (rollouts == "expert")
    if rollouts == "expert":
        assert bool(rows["episode_success"].all())


def test_a_run_goes_on_where_it_was_stopped(composed, tmp_path):
    first = bc.train(composed("experiment=smoke", "total_env_steps=12", *SHORT, recipe="bc"))
    run_dir = find_run(tmp_path)
    stored = OmegaConf.load(run_dir / ".config_unresolved.yaml")
    stored.total_env_steps = 24
    OmegaConf.save(stored, run_dir / ".config_unresolved.yaml")
    second = bc.train(composed(f"resume={run_dir}", recipe="bc"))
    assert first["gradient_steps"] == 6 + 3 and second["gradient_steps"] == 6 + 3 + 3
    assert second["env_steps"] >= 24
    name = "policy after imitation alone"
    assert first["comparison"][name] == second["comparison"][name]
    with pytest.raises(CheckpointError, match="is no run directory of td3_bc"):
        td3_bc.train(composed(f"resume={run_dir}"))


def test_what_cannot_be_is_refused(composed):
    for given in ("[]", "[nobody]", "expert", "null"):
        with pytest.raises(ConfigError, match="name those who act in turn"):
            bc.train(composed("experiment=smoke", f"online.rollouts={given}", recipe="bc"))
    undisturbed = ["demonstrations.kind=failed", "collector.disturb=null"]
    with pytest.raises(ConfigError, match=r"collector.disturb=None with online.rollouts=.*leave expert out"):
        bc.train(composed("experiment=smoke", *undisturbed, recipe="bc"))
    for way in ("online.rollouts=[learner]", "offline.updates=3"):
        bc.check_rollouts(composed("experiment=smoke", *undisturbed, way, recipe="bc"))
    cfg = composed("experiment=smoke", "total_env_steps=0", "offline.updates=auto", recipe="bc")
    with pytest.raises(ConfigError, match="which is 0: give their number"):
        bc.train(cfg)
    assert OmegaConf.select(cfg, "recipe") == "bc"


def test_policies_read_further_observations_in_training_and_evaluation(composed, tmp_path):
    further = ["model.state_inputs={joints: 9}", "replay.codec.state_keys=[time_left,joints]"]
    cell = ["experiment=[smoke,table1/dagger]", "total_env_steps=12", *SHORT, *further]
    assert bc.train(composed(*cell, recipe="bc"))["gradient_steps"] == 6 + 3
    run_dir = find_run(tmp_path)
    assert stored_rows(run_dir, "online")["joints"].any()
    options = ["episodes=2", "evaluation.num_objects=4", "evaluation.num_envs=2", "objects.num_grasps=100"]
    again = evaluate(composed(f"policy={run_dir}", *options, "collector.num_workers=0", recipe="evaluate"))
    assert again["episodes"] == 2
