"""recipes/hindsight.py: no expert, goals from success alone, frozen encoders, rates before and after."""

import torch

from recipes import hindsight
from tests.recipes.runner import find_run, heads_alone_learned, stored_rows
from torchgrasp.config import begun_with, make_expert, make_pool
from torchgrasp.geometry import goal_to_pose
from torchgrasp.runs import load_checkpoint, load_weights
from torchgrasp.transforms import HindsightGoal

SMALL = ["experiment=[smoke,hindsight/normal]", "objects=procedural"]


def test_fine_tuning_builds_no_expert_and_trains_the_heads(composed, tmp_path, trained):
    """Where there is no expert to be had it runs all the same; its episodes have no label of anybody's."""
    given = ["total_env_steps=24", f"init={trained[0]}", "expert._target_=torchgrasp.planning.RandomAction"]
    summary = hindsight.train(composed(*SMALL, *given, recipe="hindsight"))
    assert set(summary["comparison"]) == {"policy", "policy before fine-tuning"}
    assert summary["comparison"]["policy"]["episodes"] == 4 and summary["env_steps"] >= 24
    run_dir = find_run(tmp_path, "hindsight")
    rows = stored_rows(run_dir, "hindsight")
    assert len(rows["action"]) > 0 and not rows["has_expert"].any()
    assert rows["features.actor"].shape[1:] == (64,)  # its critic sees the action, and is computed anew
    assert torch.equal(rows["has_goal"], rows["episode_success"])
    assert stored_rows(run_dir, "expert")["has_expert"].any()
    # The length of episodes is the policy's, not the experiment's.
    assert load_checkpoint(run_dir / "checkpoint")["progress"]["env_steps"] % 8 == 0
    assert heads_alone_learned(trained[0], run_dir)


def test_what_has_worked_is_imitated_on_demand_and_the_critic_may_learn_alone_at_first(
    composed, tmp_path, trained
):
    """Labels are own actions where an episode succeeded; the actor stays in the only iteration."""
    given = ["total_env_steps=16", "online.critic_warmup=1", "model.critic.freeze_encoder=false"]
    given += ["online.self_imitation=true", f"init={trained[0]}"]
    hindsight.train(composed(*SMALL, *given, recipe="hindsight"))
    run_dir = find_run(tmp_path, "hindsight")
    rows = stored_rows(run_dir, "hindsight")
    assert torch.equal(rows["has_expert"], rows["episode_success"])
    assert torch.equal(rows["expert_action"], rows["action"])
    before, after = (load_weights(run / "weights.safetensors")[0] for run in (trained[0], run_dir))
    changed = {
        name: any(not torch.equal(value, after[name][key]) for key, value in states.items())
        for name, states in before.items()
    }
    assert changed == {"actor": False, "critic": True}


def test_goals_are_the_poses_that_successful_episodes_reached(composed, trained):
    """With a hand that the expert has led, some episodes succeed and have goals."""
    cfg = begun_with(composed(*SMALL, f"init={trained[0]}", recipe="hindsight"))
    with make_pool(cfg) as pool:
        (episodes,) = pool.run("test", make_expert(cfg, "test"), [0])
    assert any(each.success for each in episodes)
    for episode in episodes:
        told = episode.steps.clone()
        steps = HindsightGoal()(episode.steps)
        assert bool(steps["has_goal"].all()) is episode.success
        assert torch.equal(steps["next", "reward"], told["next", "reward"])
        if episode.success:
            reached = steps["T_base_ee"] @ goal_to_pose(steps["goal"])
            torch.testing.assert_close(reached, steps["next", "T_base_ee"][-1:].expand(reached.shape))
