"""recipes/hindsight.py: no expert, goals from success alone, frozen encoders, rates before and after."""

import shutil

import bc
import common
import hindsight
import pytest
import td3_bc
import torch
from hydra import compose, initialize_config_dir
from inherit import begun_with
from runner import ROOT, assert_heads_alone_learned
from test_bc import find_run, stored_rows

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import goal_to_pose
from torchgrasp.runs.checkpoint import load_checkpoint
from torchgrasp.runs.weights import load_weights
from torchgrasp.transforms import HindsightGoal

SMALL = ["experiment=[smoke,hindsight/normal]", "total_env_steps=24", "objects=procedural"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A trained policy's run directory."""
    root = tmp_path_factory.mktemp("trained")
    given = [f"output_dir={root}", "experiment=smoke", "evaluation.baselines=[]", "evaluation.episodes=2"]
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        cfg = compose("td3_bc", [*given, "env.horizon=8", "total_env_steps=16"])
    td3_bc.train(cfg)
    return find_run(root, "td3_bc")


def test_fine_tuning_builds_no_expert(composed, tmp_path, trained):
    """Where there is none to be had, it runs all the same; its episodes have no label of anybody's."""
    nobody = "expert._target_=no.such.Expert"
    summary = hindsight.train(composed(*SMALL, f"init={trained}", nobody, recipe="hindsight"))
    assert set(summary["comparison"]) == {"policy", "policy before fine-tuning"}
    assert summary["comparison"]["policy"]["episodes"] == 4 and summary["env_steps"] >= 24
    run_dir = find_run(tmp_path, "hindsight")
    rows = stored_rows(run_dir, "hindsight")
    assert len(rows["action"]) > 0 and not rows["has_expert"].any()
    assert torch.equal(rows["has_goal"], rows["episode_success"])
    assert stored_rows(run_dir, "expert")["has_expert"].any()
    # The length of episodes is the policy's, not the experiment's.
    assert load_checkpoint(run_dir / "checkpoint")["progress"]["env_steps"] % 8 == 0


def test_encoders_stay_and_heads_learn(composed, tmp_path, trained):
    hindsight.train(composed(*SMALL, f"init={trained}", recipe="hindsight"))
    assert_heads_alone_learned(trained, find_run(tmp_path, "hindsight"))


def test_goals_are_the_poses_that_successful_episodes_reached(composed, tmp_path, trained):
    """With a hand that the expert has led, some episodes succeed and have goals."""
    cfg = begun_with(composed(*SMALL, f"init={trained}", recipe="hindsight"))
    with common.make_pool(cfg) as pool:
        (episodes,) = pool.run("test", common.make_expert(cfg, "test"), [0])
    assert any(each.success for each in episodes)
    for episode in episodes:
        told = episode.steps.clone()
        steps = HindsightGoal()(episode.steps)
        assert bool(steps["has_goal"].all()) is episode.success
        assert torch.equal(steps["next", "reward"], told["next", "reward"])
        if episode.success:
            reached = steps["T_base_ee"] @ goal_to_pose(steps["goal"])
            torch.testing.assert_close(reached, steps["next", "T_base_ee"][-1:].expand(reached.shape))


def test_a_critic_that_imitation_has_not_trained_is_not_frozen(composed, tmp_path):
    given = ["experiment=smoke", "total_env_steps=0", "evaluation.baselines=[]", "evaluation.episodes=2"]
    bc.train(composed(*given, recipe="bc"))
    init = f"init={find_run(tmp_path, 'bc')}"
    with pytest.raises(ConfigError, match=r"critic.freeze_encoder=true would keep random weights"):
        hindsight.train(composed(*SMALL, init, recipe="hindsight"))
    assert not (tmp_path / "hindsight").exists()
    cfg = composed(*SMALL, init, "model.critic.freeze_encoder=false", recipe="hindsight")
    assert hindsight.train(cfg)["env_steps"] >= 24


def test_what_cannot_be_fine_tuned_is_refused(composed, tmp_path, trained):
    with pytest.raises(ConfigError, match="init is missing"):
        hindsight.train(composed(*SMALL, recipe="hindsight"))
    with pytest.raises(ConfigError, match="leaves no episodes"):
        hindsight.train(composed(*SMALL, f"init={trained}", "offline.updates=3", recipe="hindsight"))
    given = [f"init={trained}", f"demonstrations.path={tmp_path / 'nowhere'}"]
    with pytest.raises(ConfigError, match="holds none"):
        hindsight.train(composed(*SMALL, *given, recipe="hindsight"))
    more = "demonstrations.more={failed: {kind: failed}}"
    with pytest.raises(
        ConfigError, match=r"demonstrations.more.failed has no path.* give failed that folder"
    ):
        hindsight.train(composed(*SMALL, f"init={trained}", more, recipe="hindsight"))
    alone = shutil.copy(trained / "weights.safetensors", tmp_path / "alone.safetensors")
    with pytest.raises(ConfigError, match="has no demonstrations beside it"):
        hindsight.train(composed(*SMALL, f"init={alone}", recipe="hindsight"))
    assert not (tmp_path / "hindsight").exists()


def test_what_has_worked_is_imitated_on_demand(composed, tmp_path, trained):
    """Labels of D_hindsight are its own actions, where the episode succeeded and nowhere else."""
    options = ["online.self_imitation=true"]
    hindsight.train(composed(*SMALL, f"init={trained}", *options, recipe="hindsight"))
    rows = stored_rows(find_run(tmp_path, "hindsight"), "hindsight")
    assert torch.equal(rows["has_expert"], rows["episode_success"])
    assert torch.equal(rows["expert_action"], rows["action"])


@pytest.mark.parametrize("given", ["num_points=64", "transforms.aggregate.alpha=0.9"])
def test_what_the_first_run_brings_along_is_not_given_anew(run_recipe, trained, given):
    code, _, err = run_recipe("hindsight", *SMALL, f"init={trained}", given)
    assert code == 1 and f"leave out {given.split('=')[0]}" in err


def test_the_critic_may_learn_alone_at_first(composed, tmp_path, trained):
    """In a run of one iteration the actor stays while the critic learns."""
    given = ["total_env_steps=16", "online.critic_warmup=1", "model.critic.freeze_encoder=false"]
    hindsight.train(composed(*SMALL, *given, f"init={trained}", recipe="hindsight"))
    before, after = (
        load_weights(run / "weights.safetensors")[0] for run in (trained, find_run(tmp_path, "hindsight"))
    )
    changed = {
        name: any(not torch.equal(value, after[name][key]) for key, value in states.items())
        for name, states in before.items()
    }
    assert changed == {"actor": False, "critic": True}
