"""recipes/bc.py: who acts, what is learned from, and that no critic is there."""

import pytest
import torch
from omegaconf import OmegaConf

from recipes import bc, td3_bc
from recipes.evaluate import evaluate
from tests.configurations import change_run
from tests.recipes.runner import find_run, read_metrics, stored_rows
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import load_weights

SHORT = ["evaluation.baselines=[]", "evaluation.episodes=2"]
EVALUATED = ["episodes=2", "evaluation.num_objects=4", "evaluation.num_envs=2", "objects.num_grasps=100"]
EVALUATED += ["collector.num_workers=0"]


@pytest.mark.slow
def test_offline_learns_from_demonstrations_alone_and_without_a_critic(composed, tmp_path):
    summary = bc.train(composed("experiment=[smoke,table1/offline]", *SHORT, recipe="bc"))
    assert summary["env_steps"] == 0
    # 6 updates first, then as many as 48 steps in iterations of 12 bring, 3 each.
    assert summary["gradient_steps"] == 6 + 4 * 3
    assert set(summary["comparison"]) == {"policy", "policy after imitation alone"}
    run_dir = find_run(tmp_path, "bc")
    assert set(load_weights(run_dir / "weights.safetensors")[0]) == {"actor"}
    assert (run_dir / "report.html").exists() and not (run_dir / "tensorboard").exists()
    # A row for the phase of imitation, then one an iteration: means over its updates.
    assert [row["step"] for row in read_metrics(run_dir)][:5] == ["6", "9", "12", "15", "18"]


def test_a_run_goes_on_is_evaluated_and_begins_reinforcement(composed, tmp_path):
    cell = ["experiment=[smoke,table1/dagger_aux]", "total_env_steps=12", *SHORT]
    first = bc.train(composed(*cell, recipe="bc"))
    run_dir = find_run(tmp_path, "bc")
    change_run(run_dir, total_env_steps=24)
    second = bc.train(composed(f"resume={run_dir}", recipe="bc"))
    assert first["gradient_steps"] == 6 + 3 and second["gradient_steps"] == 6 + 3 + 3
    assert second["env_steps"] >= 24
    name = "policy after imitation alone"
    assert first["comparison"][name] == second["comparison"][name]
    with pytest.raises(CheckpointError, match="is no run directory of td3_bc"):
        td3_bc.train(composed(f"resume={run_dir}"))

    again = evaluate(composed(f"policy={run_dir}", *EVALUATED, "grasp_prediction=true", recipe="evaluate"))
    assert again["env_steps"] == second["comparison"]["policy"]["env_steps"]
    assert set(again["grasp_prediction"]) == {"actor"}

    begun = [f"init={run_dir}", f"demonstrations.path={run_dir / 'demonstrations'}"]
    td3_bc.train(composed("experiment=smoke", *begun, "total_env_steps=0", "pretrain.steps=0", *SHORT))
    before = load_weights(run_dir / "weights.safetensors")[0]["actor"]
    after = load_weights(find_run(tmp_path, "td3_bc") / "weights.safetensors")[0]["actor"]
    assert all(torch.equal(before[key], after[key]) for key in before)


@pytest.mark.parametrize("rollouts", ["expert", "learner"])
@pytest.mark.slow
def test_who_acts_and_who_labels(composed, tmp_path, rollouts):
    chosen = [f"online.rollouts=[{rollouts}]", "demonstrations.kind=expert", "total_env_steps=24"]
    further = ["model.state_inputs={joints: 9}", "replay.codec.state_keys=[time_left,joints]"]
    bc.train(composed("experiment=smoke", *chosen, *further, "env.horizon=12", *SHORT, recipe="bc"))
    run_dir = find_run(tmp_path, "bc")
    rows = stored_rows(run_dir, "online")
    label, acted = rows["expert_action"], rows["action"]
    known = rows["has_expert"].squeeze(-1)
    assert known.float().mean() > 0.5
    same = (label == acted).all(-1)[known]
    assert bool(same.all()) is (rollouts == "expert")
    if rollouts == "expert":
        assert bool(rows["episode_success"].all())
        return
    # Further observations are read in training and evaluation.
    assert rows["joints"].any()
    assert evaluate(composed(f"policy={run_dir}", *EVALUATED, recipe="evaluate"))["episodes"] == 2


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
