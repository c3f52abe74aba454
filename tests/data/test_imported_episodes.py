"""Episodes of other formats on their way into shards."""

import torch
from tensordict import TensorDict

from torchgrasp.data.imported_episodes import in_groups


def draw_episodes(count, taken):
    """Episodes of 4,000 bytes, told of as they are read."""
    for number in range(count):
        taken.append(number)
        yield TensorDict({"depth": torch.zeros(10, 10, 10)}, [10]), f"object {number}", number


def get_rows(episode):
    return episode[0]


def test_groups_are_of_28_episodes():
    groups = list(in_groups(draw_episodes(60, []), get_rows))
    assert [len(group) for group in groups] == [28, 28, 4]
    assert [seed for group in groups for _, _, seed in group] == list(range(60))
    assert not list(in_groups(draw_episodes(0, []), get_rows))


def test_groups_of_large_episodes_are_smaller_and_no_episode_is_read_ahead(monkeypatch):
    monkeypatch.setattr("torchgrasp.data.imported_episodes._SHARD_BYTES", 9000)
    taken = []
    groups = in_groups(draw_episodes(7, taken), get_rows)
    assert len(next(groups)) == 3 and taken == [0, 1, 2]
    assert [len(group) for group in groups] == [3, 1]
