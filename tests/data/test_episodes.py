import pytest
import torch
from tensordict import TensorDict

from tests.data.rollouts import make_rollout
from torchgrasp.data import label_episode_success, split_episodes, split_tries
from torchgrasp.errors import ConfigError
from torchgrasp.transforms import HindsightGoal


def make_outcomes(reward, done):
    reward, done = torch.tensor(reward, dtype=torch.float32)[..., None], torch.tensor(done).bool()[..., None]
    return TensorDict({"next": {"reward": reward, "done": done}}, reward.shape[:-1])


def test_success_reaches_back_to_the_episodes_first_step_and_no_further():
    steps = make_outcomes([[0, 0, 0, 1, 0], [0, 1, 0, 0, 0]], [[0, 1, 0, 1, 0], [0, 1, 0, 0, 1]])
    success = label_episode_success(steps)["episode_success"].squeeze(-1).int().tolist()
    assert success == [[0, 0, 1, 1, 0], [1, 1, 0, 0, 0]]


def test_a_reward_before_the_end_is_no_success():
    steps = label_episode_success(make_outcomes([1, 0, 1], [0, 1, 0]))
    assert not steps["episode_success"].any()


@pytest.mark.parametrize("name", [("collector", "traj_ids"), "traj_ids", "world", "episode", "source"])
def test_success_stops_at_the_border_of_two_trajectories(name):
    # The first trajectory is cut off after two steps; the second succeeds after three.
    steps = make_outcomes([0, 0, 0, 0, 1], [0, 0, 0, 0, 1])
    steps[name] = torch.tensor([0, 0, 1, 1, 1])
    success = label_episode_success(steps)["episode_success"].squeeze(-1)
    assert success.int().tolist() == [0, 0, 1, 1, 1]
    (episode,) = split_episodes(steps)
    assert len(episode) == 3


def test_padding_belongs_to_no_episode():
    # Padding between steps parts them, and what it holds is not read.
    steps = make_outcomes([0, 0, 1, 0, 1], [0, 0, 1, 0, 1])
    steps["mask"] = torch.tensor([1, 1, 0, 1, 1]).bool()
    success = label_episode_success(steps)["episode_success"].squeeze(-1)
    assert success.int().tolist() == [0, 0, 0, 1, 1]
    (episode,) = split_episodes(steps)
    assert len(episode) == 2


def test_a_step_alone_is_refused():
    step = make_outcomes([1, 0], [1, 0])[0]
    for refuse in (label_episode_success, split_episodes):
        with pytest.raises(ConfigError, match=r"\(\*, T\), time last"):
            refuse(step)


def test_split_gives_whole_episodes_only():
    rollout = make_rollout(5, 30, generator=torch.Generator().manual_seed(0))
    episodes = split_episodes(rollout)
    assert len(episodes) == rollout["next", "done"].sum()
    for episode in episodes:
        assert episode["next", "done"].squeeze(-1).nonzero().squeeze(-1).tolist() == [len(episode) - 1]
        state = episode["time_left"].squeeze(-1)
        assert torch.equal(state, state[0] + torch.arange(len(episode)))


def _tried(rewards: list[float], steps: int = 3) -> TensorDict:
    """An episode (T) at whose end as many actions were tried."""
    done = torch.zeros(steps, 1, dtype=torch.bool)
    done[-1] = True
    told = torch.full((steps, len(rewards), 1), torch.nan)
    told[-1, :, 0] = torch.tensor(rewards)
    flags = {key: torch.ones(steps, 1, dtype=torch.bool) for key in ("has_expert", "has_goal")}
    following = {"done": done, "reward": done.float(), "tried_reward": told, "has_goal": flags["has_goal"]}
    acted = {"action": torch.zeros(steps, 6), "tried_action": torch.rand(steps, len(rewards), 6)}
    return TensorDict({"state": torch.rand(steps, 2), **flags, **acted, "next": following}, [steps])


def test_what_was_tried_at_the_end_becomes_episodes_of_one_step():
    steps = _tried([1.0, torch.nan, 0.0])
    tries = split_tries(steps)
    assert tries.batch_size == (2, 1)
    assert torch.equal(tries["action"][:, 0], steps["tried_action"][-1, [0, 2]])
    assert tries["next", "reward"].flatten().tolist() == [1.0, 0.0] and tries["next", "done"].all()
    assert torch.equal(tries["state"], steps["state"][-1].expand(2, 1, 2))
    # They teach a critic alone, and the episode itself stays as it was.
    assert not tries["has_expert"].any() and not tries["has_goal"].any()
    assert not tries["next", "has_goal"].any() and steps["has_expert"].all()
    assert label_episode_success(tries)["episode_success"].flatten().tolist() == [True, False]


def test_where_a_tried_action_led_is_no_goal_in_hindsight():
    steps, poses = _tried([1.0]), torch.eye(4).repeat(3, 1, 1)
    tries = split_tries(steps.set("T_base_ee", poses).set(("next", "T_base_ee"), poses.clone()))
    relabelled = HindsightGoal(imitate=True)(tries)
    assert not relabelled["has_goal"].any() and not relabelled["has_expert"].any()
    assert relabelled["goal"].isfinite().all() and HindsightGoal()(steps)["has_goal"].all()


def test_an_episode_without_tries_gives_none():
    assert split_tries(_tried([torch.nan, torch.nan])).batch_size == (0, 1)
    assert split_tries(_tried([1.0]).exclude("tried_action")).batch_size == (0, 1)
