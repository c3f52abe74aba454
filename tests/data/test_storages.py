"""MixtureSampler over every kind of storage that TorchRL has, and over storages that others wrote to."""

import copy
import pickle

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import (
    LazyMemmapStorage,
    LazyStackStorage,
    LazyTensorStorage,
    ListStorage,
    ReplayBuffer,
    TensorDictReplayBuffer,
    TensorStorage,
)

from torchgrasp.data import MixtureSampler, Priority
from torchgrasp.errors import ConfigError

SHARES = {"online": 0.7, "expert": 0.3}
STORAGES = {
    "list": lambda: ListStorage(100),
    "stack": lambda: LazyStackStorage(100),
    "tensor": lambda: LazyTensorStorage(100),
    "memmap": lambda: LazyMemmapStorage(100),
    "two dimensions": lambda: LazyTensorStorage(100, ndim=2),
}


def make_rows(*shape, seed=0):
    source = torch.randint(2, (*shape, 1), generator=torch.Generator().manual_seed(seed))
    return TensorDict({"x": source.float() * 100, "source": source}, shape)


def make_buffer(storage=None, sampler=None, **options):
    sampler = sampler or MixtureSampler(SHARES)
    return TensorDictReplayBuffer(storage=storage, sampler=sampler, batch_size=10, **options)


def count(batch):
    return torch.bincount(batch["source"].reshape(-1), minlength=2).tolist()


@pytest.mark.parametrize("kind", STORAGES)
@pytest.mark.parametrize("priority", [None, Priority()], ids=["uniform", "prioritised"])
def test_shares_are_exact_in_every_storage_also_when_it_wraps(kind, priority):
    buffer = make_buffer(STORAGES[kind](), MixtureSampler(SHARES, priority=priority))
    for turn in range(12):
        buffer.extend(make_rows(4, 5, seed=turn) if kind == "two dimensions" else make_rows(20, seed=turn))
        batch = buffer.sample()
        assert batch.shape == (10,) and count(batch) == [7, 3]
        assert torch.equal(batch["x"], batch["source"].float() * 100)
        buffer.update_priority(batch["index"], torch.rand(10))
    held = buffer[:]
    held = torch.stack(held) if isinstance(held, list) else held
    assert [*buffer.sampler.num_rows().values()] == count(held)


def test_the_default_storage_of_torchrls_buffers_does():
    buffer = TensorDictReplayBuffer(sampler=MixtureSampler(SHARES), batch_size=10)
    buffer.extend(make_rows(50))
    buffer.add(make_rows(1)[0])
    assert count(buffer.sample()) == [7, 3] and sum(buffer.sampler.num_rows().values()) == 51


def test_errors_reach_their_rows_in_two_dimensions():
    sampler = MixtureSampler({"one": 1.0}, priority=Priority(alpha=1.0, eps=1e-9))
    buffer = make_buffer(LazyTensorStorage(100, ndim=2), sampler)
    numbers = torch.arange(20).reshape(4, 5)
    buffer.extend(TensorDict({"x": numbers, "source": numbers * 0}, [4, 5]))
    batch = buffer.sample()
    buffer.update_priority(batch["index"], torch.where(batch["x"] == batch["x"][0], 1e6, 1e-3))
    again = buffer.sample(200)["x"]
    assert (again == batch["x"][0]).float().mean() > 0.95


def test_a_storage_that_was_filled_before_is_drawn_from():
    storage = LazyTensorStorage(100)
    first = TensorDictReplayBuffer(storage=storage, batch_size=10)
    first.extend(make_rows(40))
    buffer = make_buffer(storage)
    assert count(buffer.sample()) == [7, 3] and sum(buffer.sampler.num_rows().values()) == 40
    first.extend(make_rows(30, seed=1))  # through another buffer
    assert sum(buffer.sampler.num_rows().values()) == 70
    full = make_buffer(TensorStorage(make_rows(40)))
    assert count(full.sample()) == [7, 3]


def test_a_sampler_may_come_later_and_change_its_storage():
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=10)
    buffer.extend(make_rows(40))
    buffer.set_sampler(MixtureSampler(SHARES))
    assert count(buffer.sample()) == [7, 3]
    buffer.set_storage(TensorStorage(make_rows(6, seed=3)))
    buffer.sample()
    assert [*buffer.sampler.num_rows().values()] == count(make_rows(6, seed=3))


def test_rows_written_past_every_buffer_are_seen():
    buffer = make_buffer(LazyTensorStorage(100))
    buffer.extend(make_rows(40))
    turned = make_rows(40)
    turned["source"] = 1 - turned["source"]
    buffer.storage.set(torch.arange(40), turned, set_cursor=False)
    assert count(buffer.sample()) == [7, 3]
    assert [*buffer.sampler.num_rows().values()] == count(turned)


def test_a_sampler_that_fell_behind_catches_up():
    sampler = MixtureSampler(SHARES, priority=Priority())
    buffer = make_buffer(LazyTensorStorage(3000), sampler)
    buffer.extend(make_rows(100))
    sampler._follows = False  # as in a process that only writes
    for seed in range(1100):
        buffer.extend(make_rows(2, seed=seed))
    assert count(buffer.sample()) == [7, 3]
    assert [*sampler.num_rows().values()] == count(buffer[:])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
def test_a_copy_goes_its_own_way(duplicate):
    buffer = make_buffer(LazyTensorStorage(100))
    buffer.extend(make_rows(40))
    other = duplicate(buffer)
    other.extend(make_rows(40, seed=1))
    assert count(other.sample()) == count(buffer.sample()) == [7, 3]
    assert sum(other.sampler.num_rows().values()) == 80
    assert sum(buffer.sampler.num_rows().values()) == 40


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (make_rows(8, 5), r"one number is expected.*reshape"),
        (make_rows(8).exclude("source"), "written without 'source'"),
    ],
)
def test_rows_without_one_source_each_are_refused(data, message):
    with pytest.raises(ConfigError, match=message):
        make_buffer(LazyTensorStorage(100)).extend(data)


def test_rows_that_are_no_tensordicts_are_refused():
    buffer = ReplayBuffer(storage=LazyTensorStorage(100), sampler=MixtureSampler(SHARES), batch_size=10)
    with pytest.raises(ConfigError, match="storage of Tensors: store TensorDicts"):
        buffer.extend(torch.zeros(5, 3))
