"""A replay buffer is saved in one way, whoever asks for it."""

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.data import CompactTransitions, MixtureReplayBuffer, Priority
from torchgrasp.data.state_files import StateFiles, read_state, write_state
from torchgrasp.errors import CheckpointError
from torchgrasp.runs import save_checkpoint


def make_buffer(seed=0):
    return MixtureReplayBuffer(
        {"online": 20, "expert": 20},
        {"online": 0.5, "expert": 0.5},
        batch_size=10,
        seed=seed,
        priority=Priority(),
        codec=CompactTransitions(points_key=None, gripper_points=False),
    )


def make_steps(count):
    done = torch.arange(count)[:, None] == count - 1
    state = {"time_left": torch.rand(count, 1)}
    following = {**state, "done": done, "terminated": done, "reward": torch.zeros(count, 1)}
    return TensorDict({**state, "action": torch.randn(count, 6), "next": following}, [count])


def read_bytes(folder, name):
    return [(folder / f"{name}.{ending}").read_bytes() for ending in ("json", "safetensors")]


def test_dumps_writes_what_a_checkpoint_holds_and_loads_reads_it(tmp_path):
    first, second = make_buffer(), make_buffer(seed=1)
    for source in ("online", "expert"):
        first.extend(make_steps(9), source=source)
    first.dumps(tmp_path / "dumped")
    save_checkpoint(tmp_path / "checkpoint", {"buffer": first.state_dict()})
    assert read_bytes(tmp_path / "dumped", "state") == read_bytes(tmp_path / "checkpoint", "buffer")
    second.loads(tmp_path / "dumped")
    assert bool((first.sample() == second.sample()).all())


def test_each_part_of_the_buffer_is_written_that_way():
    buffer = make_buffer()
    parts = (buffer, buffer.sampler, buffer.storage, buffer.writer)
    assert all(type(part).dumps is StateFiles.dumps for part in parts)


def test_tensors_of_a_state_written_before_are_gone(tmp_path):
    write_state(tmp_path, "state", {"x": torch.zeros(2)})
    write_state(tmp_path, "state", {"y": 3})
    assert read_state(tmp_path, "state", "") == {"y": 3}
    assert [file.name for file in tmp_path.iterdir()] == ["state.json"]


def test_a_folder_without_state_is_named_with_the_remedy(tmp_path):
    with pytest.raises(CheckpointError, match=r"state\.json is missing.*dumps has written"):
        make_buffer().loads(tmp_path)
