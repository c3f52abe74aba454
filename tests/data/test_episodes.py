import torch
from rollouts import make_rollout
from tensordict import TensorDict

from torchgrasp.data import label_episode_success, split_episodes


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


def test_split_gives_whole_episodes_only():
    rollout = make_rollout(5, 30, generator=torch.Generator().manual_seed(0))
    episodes = split_episodes(rollout)
    assert len(episodes) == rollout["next", "done"].sum()
    for episode in episodes:
        assert episode["next", "done"].squeeze(-1).nonzero().squeeze(-1).tolist() == [len(episode) - 1]
        state = episode["time_left"].squeeze(-1)
        assert torch.equal(state, state[0] + torch.arange(len(episode)))
