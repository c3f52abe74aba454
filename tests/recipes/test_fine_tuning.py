"""recipes/td3_bc.py with init=: heads on frozen encoders, hindsight goals, and what init is needed for."""

import shutil

import pytest
import torch

from recipes import td3_bc
from tests.recipes.runner import find_run, heads_alone_learned
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import load_weights

SHORT = ["experiment=smoke", "env.horizon=8", "evaluation.baselines=[]", "evaluation.episodes=2"]
FROZEN = ["model.actor.freeze_encoder=true", "model.critic.freeze_encoder=true"]
HINDSIGHT = ["loss.hindsight=true", "replay.augment={_target_: torchgrasp.transforms.HindsightGoal}"]


@pytest.fixture
def begun(trained):
    """Options of a short run on the demonstrations of a trained one, begun with its weights."""
    run_dir, _ = trained
    return [*SHORT, f"init={run_dir}", f"demonstrations.path={run_dir / 'demonstrations'}"]


def test_heads_learn_from_where_the_first_run_ended(composed, tmp_path, trained, begun):
    td3_bc.train(composed(*begun, "total_env_steps=16", "seed=7", *FROZEN, *HINDSIGHT))
    assert heads_alone_learned(trained[0], find_run(tmp_path, "td3_bc"))


def test_init_is_needed_until_there_is_a_checkpoint(composed, tmp_path, trained, begun):
    first = shutil.copytree(trained[0], tmp_path / "first")
    still = ["total_env_steps=0", "pretrain.steps=0", f"init={first}"]
    td3_bc.train(composed(*begun[:-2], *still, begun[-1]))
    second = find_run(tmp_path, "td3_bc")
    resume = f"resume={second}"
    first.rename(tmp_path / "moved")
    assert td3_bc.train(composed(resume))["env_steps"] == 0
    shutil.rmtree(second / "checkpoint")
    (second / "weights.safetensors").unlink()
    with pytest.raises(ConfigError, match=f"init='{first}' is not there: give .*a run directory"):
        td3_bc.train(composed(resume))
    (tmp_path / "moved").rename(first)
    td3_bc.train(composed(resume))
    before, after = (load_weights(each / "weights.safetensors")[0] for each in (first, second))
    for name, states in before.items():
        assert all(torch.equal(value, after[name][key]) for key, value in states.items())


def test_the_pretrained_policy_can_be_trained_on(composed, begun):
    theirs = ["model.width=1", "model.table_input=true", "model.state_inputs={wrist_angle: 1}"]
    given = [each for each in begun if not each.startswith("init=")]
    summary = td3_bc.train(
        composed(*given, *theirs, "init=pretrained", "pretrain.steps=0", "total_env_steps=1")
    )
    assert summary["gradient_steps"] == 3


def test_weights_of_other_networks_are_refused_before_a_run_begins(composed, tmp_path, begun):
    with pytest.raises(CheckpointError, match="weights of other networks"):
        td3_bc.train(composed(*begun, "model.width=0.5"))
    assert not list(tmp_path.iterdir())
