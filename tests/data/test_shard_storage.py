"""TorchRL's buffers over the files of demonstrations: the same transitions, none copied."""

import pickle

import pytest
import torch
from torchrl.data import TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.envs.transforms import RenameTransform

from tests.data.rollouts import append, make_cloud, make_episodes, make_steps
from torchgrasp.data import CompactTransitions, ShardStorage, append_shard, open_demonstrations
from torchgrasp.data.storage import keep_batch
from torchgrasp.errors import ConfigError


@pytest.fixture
def demonstrations(tmp_path):
    append(tmp_path, 0)
    append_shard(tmp_path, [], objects=[], seeds=[], index=1)
    append(tmp_path, 2)
    return open_demonstrations(tmp_path)


def number(batch):
    """Which state a step begins in: `time_left` numbers those of one shard, points tell shards apart."""
    return [tuple(row.tolist()) for row in torch.cat((batch["time_left"], batch["action"]), -1)]


def check_transitions(batch, episodes):
    steps = torch.cat(episodes)
    row_of = {key: row for row, key in enumerate(number(steps))}
    steps = steps[[row_of[key] for key in number(batch)]]
    for key in ("points", "expert_action", "goal", "has_goal", "perturbed", "has_expert"):
        assert torch.equal(batch[key], steps[key])
    for key in ("reward", "terminated", "done"):
        assert torch.equal(batch["next", key], steps["next", key])
    live = ~steps["next", "terminated"].squeeze(-1)
    for key in ("points", "time_left"):
        assert torch.equal(batch["next", key][live], steps["next", key][live])


def test_samples_are_the_transitions_of_the_episodes(demonstrations):
    episodes = make_episodes(0) + make_episodes(2)
    buffer = demonstrations.buffer(batch_size=64, seed=1)
    assert len(buffer) == sum(map(len, episodes)) < demonstrations.card["rows"]
    batches = [buffer.sample() for _ in range(10)]
    for batch in batches:
        check_transitions(batch, episodes)
    again = demonstrations.buffer(batch_size=64, seed=1)
    assert torch.equal(again.sample()["action"], batches[0]["action"])
    renamed = demonstrations.buffer(batch_size=4, transform=RenameTransform(["points"], ["cloud"]))
    assert renamed.sample()["cloud"].shape == (4, 14, 4)


def test_a_buffer_of_ones_own_draws_each_transition_once(demonstrations):
    codec = CompactTransitions()
    buffer = TensorDictReplayBuffer(
        storage=ShardStorage(tuple(demonstrations.iterate_rows()), next_keys=codec.observation_keys),
        sampler=SamplerWithoutReplacement(drop_last=False),
        transform=codec,
        collate_fn=keep_batch,
        batch_size=16,
    )
    episodes = make_episodes(0) + make_episodes(2)
    batches = [buffer.sample() for _ in range(-(-len(buffer) // 16))]
    drawn = [key for batch in batches for key in number(batch)]
    assert sorted(drawn) == sorted(number(torch.cat(episodes)))


@pytest.mark.parametrize("count", ["successful", "failed"])
def test_episodes_are_chosen_by_their_outcome(demonstrations, count):
    buffer = demonstrations.buffer(batch_size=200, count=count)
    assert len(buffer) == demonstrations.card[f"{count}_steps"]
    assert bool((buffer.sample()["episode_success"] == (count == "successful")).all())


def test_indices_of_any_shape(demonstrations):
    storage = ShardStorage(tuple(demonstrations.iterate_rows()), next_keys=["points", "time_left"])
    assert storage[3].shape == () and storage[2:7].shape == (5,) and len(storage[[1, 2]]) == 2
    assert storage[torch.tensor([[5, 0], [9, 5]])].shape == (2, 2)
    assert torch.equal(storage[torch.tensor([5, 0])]["action"][0], storage[5]["action"])


def test_an_empty_index_gives_an_empty_batch(demonstrations):
    storage = ShardStorage(tuple(demonstrations.iterate_rows()), next_keys=("points",))
    for index in ([], slice(0, 0), torch.zeros(0, 3, dtype=torch.int64)):
        batch, full = storage.get(index), storage.get([0])
        assert len(batch) == 0 and set(batch.keys(True)) == set(full.keys(True))
        assert batch["next", "points"].shape[-2:] == full["points"].shape[-2:]


def test_the_files_are_read_only_and_state_is_small(demonstrations, tmp_path):
    buffer = demonstrations.buffer(batch_size=8)
    with pytest.raises(RuntimeError, match="writing"):
        buffer.extend(make_episodes(0)[0])
    with pytest.raises(ConfigError, match="read-only"):
        buffer._storage.set(0, None)
    state = buffer.state_dict()
    buffer.load_state_dict(state)
    buffer.dumps(tmp_path / "buffer")
    buffer.loads(tmp_path / "buffer")
    assert sum(file.stat().st_size for file in (tmp_path / "buffer" / "storage").iterdir()) < 100
    other = demonstrations.buffer(batch_size=8, count="failed")
    with pytest.raises(ConfigError, match="cannot go on"):
        other.load_state_dict(state)
    with pytest.raises(ConfigError, match="'best'"):
        demonstrations.buffer(batch_size=8, count="best")


def test_another_process_gets_names_of_files(demonstrations):
    storage = ShardStorage(tuple(demonstrations.iterate_rows()), next_keys=["points", "time_left"])
    batch = storage[torch.arange(20)]
    packed = pickle.dumps(storage)
    assert len(packed) < demonstrations.card["bytes"] / 2
    assert bool((pickle.loads(packed)[torch.arange(20)] == batch).all())


def anonymous_bytes():
    """Memory of this process that no file stands behind."""
    with open("/proc/self/status") as stream:
        (line,) = [line for line in stream if line.startswith("RssAnon")]
    return int(line.split()[1]) * 1024


def test_memory_does_not_grow_by_the_dataset(tmp_path):
    steps, generator = 1000, torch.Generator().manual_seed(0)
    done = torch.arange(steps) == steps - 1
    episode = make_steps(torch.arange(steps), done, done & ~done, generator)
    episode["points"] = make_cloud(torch.arange(steps), 1024)
    episode["next", "points"] = make_cloud(torch.arange(steps) + 1, 1024)
    for index in range(12):
        card = append_shard(tmp_path, [episode], objects=["mug"], seeds=[0], index=index)
    del episode
    assert card["bytes"] > 70e6
    open_demonstrations(tmp_path).buffer(batch_size=50).sample()
    before = anonymous_bytes()
    buffer = open_demonstrations(tmp_path).buffer(batch_size=50)
    for _ in range(50):
        buffer.sample()
    assert anonymous_bytes() - before < 0.2 * card["bytes"]
