"""Fine-tuning of a trained policy with hindsight goals and frozen encoders (Sec. 6.1, 6.3)."""

import shutil

import pytest
import td3_bc
import torch
from hydra.errors import InstantiationException
from runner import assert_heads_alone_learned

from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs.weights import load_weights

SHORT = ["experiment=smoke", "total_env_steps=12", "evaluation.baselines=[]", "evaluation.episodes=2"]
FROZEN = ["model.actor.freeze_encoder=true", "model.critic.freeze_encoder=true"]
HINDSIGHT = ["loss.hindsight=true", "replay.augment={_target_: torchgrasp.transforms.HindsightGoal}"]


def _trained(composed, tmp_path, *overrides):
    td3_bc.train(composed(*SHORT, *overrides))
    runs = sorted((tmp_path / "td3_bc").iterdir(), key=lambda each: each.stat().st_mtime)
    return runs[-1]


def test_heads_learn_from_where_the_first_run_ended(composed, tmp_path):
    first = _trained(composed, tmp_path)
    tuned = _trained(composed, tmp_path, f"init={first}", "seed=7", *FROZEN, *HINDSIGHT)
    assert_heads_alone_learned(first, tuned)


def test_a_run_that_was_stopped_before_its_first_checkpoint_still_begins_with_init(composed, tmp_path):
    still = ["total_env_steps=0", "pretrain.steps=0"]
    first = _trained(composed, tmp_path)
    second = _trained(composed, tmp_path, f"init={first}", "seed=7", *still)
    shutil.rmtree(second / "checkpoint")
    (second / "weights.safetensors").unlink()
    td3_bc.train(composed(f"resume={second}"))
    before, after = (load_weights(each / "weights.safetensors")[0] for each in (first, second))
    for name, states in before.items():
        assert all(torch.equal(value, after[name][key]) for key, value in states.items())


def test_a_run_with_a_checkpoint_goes_on_without_its_init(composed, tmp_path):
    still = ["total_env_steps=0", "pretrain.steps=0"]
    first = _trained(composed, tmp_path, *still)
    second = _trained(composed, tmp_path, f"init={first}", *still)
    first.rename(tmp_path / "moved")
    resume = f"resume={second}"
    assert td3_bc.train(composed(resume))["env_steps"] == 0
    shutil.rmtree(second / "checkpoint")
    with pytest.raises(ConfigError, match=f"init='{first}' is not there: give .*a run directory"):
        td3_bc.train(composed(resume))


def test_what_cannot_begin_is_refused_before_anything_is_collected(composed, tmp_path):
    with pytest.raises(ConfigError, match=r"freeze_encoder=true would keep random weights.*init="):
        td3_bc.train(composed(*SHORT, *FROZEN))
    with pytest.raises(ConfigError, match=r"init='nowhere'"):
        td3_bc.train(composed(*SHORT, "init=nowhere"))
    with pytest.raises(ConfigError, match=r"transitions would fit"):
        td3_bc.train(composed(*SHORT, "replay.online_capacity=1000000000000"))
    with pytest.raises(InstantiationException, match=r"priority.alpha=2"):
        td3_bc.train(composed(*SHORT, "replay=prioritised", "replay.priority.alpha=2"))
    with pytest.raises(ConfigError, match=r"device=cuda:99"):
        td3_bc.train(composed(*SHORT, "device=cuda:99"))
    assert not (tmp_path / "td3_bc").exists()


def test_weights_of_other_networks_are_refused(composed, tmp_path):
    first = _trained(composed, tmp_path, "total_env_steps=0")
    with pytest.raises(CheckpointError, match="weights of other networks"):
        td3_bc.train(composed(*SHORT, f"init={first}", "model.width=0.5"))
