import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from torchgrasp.data import MixtureSampler, MixtureStorage, MixtureWriter, anneal_shares
from torchgrasp.errors import ConfigError

SHARES = {"online": 0.7, "expert": 0.3}


def make_buffer(capacities, shares, *, batch_size=250, seed=0):
    return TensorDictReplayBuffer(
        storage=MixtureStorage(capacities),
        sampler=MixtureSampler(shares),
        writer=MixtureWriter(),
        collate_fn=lambda batch: batch,
        batch_size=batch_size,
        generator=torch.Generator().manual_seed(seed),
    )


def make_rows(values, source):
    values = torch.as_tensor(values, dtype=torch.float32)
    return TensorDict({"x": values, "source": torch.full((len(values), 1), source)}, [len(values)])


def count(batch, num_sources=2):
    return torch.bincount(batch["source"].reshape(-1), minlength=num_sources).tolist()


def test_every_batch_holds_the_exact_shares():
    buffer = make_buffer({"online": 500, "expert": 100}, SHARES)
    buffer.extend(make_rows(range(400), 0))
    buffer.extend(make_rows(range(30), 1))
    assert all(count(buffer.sample()) == [175, 75] for _ in range(20))


def test_three_sources():
    buffer = make_buffer({"a": 50, "b": 50, "c": 50}, {"a": 0.5, "b": 0.3, "c": 0.2}, batch_size=100)
    for source in (2, 0, 1):
        buffer.extend(make_rows(range(20), source))
    assert count(buffer.sample(), 3) == [50, 30, 20]


def test_an_empty_source_gives_its_rows_to_the_others_in_proportion():
    shares = {"a": 0.5, "b": 0.3, "c": 0.2}
    buffer = make_buffer({"a": 50, "b": 50, "c": 50}, shares, batch_size=80)
    buffer.extend(make_rows(range(20), 0))
    buffer.extend(make_rows(range(20), 1))
    assert count(buffer.sample(), 3) == [50, 30, 0]


def test_sampling_nothing_says_what_is_missing():
    buffer = make_buffer({"online": 50, "expert": 50}, {"online": 1.0, "expert": 0.0})
    with pytest.raises(RuntimeError, match="nothing to sample"):
        buffer.sample()
    buffer.extend(make_rows(range(3), 1))
    with pytest.raises(RuntimeError, match="'online': 0, 'expert': 3"):
        buffer.sample()


def test_shares_anneal():
    buffer = make_buffer({"online": 50, "expert": 50}, SHARES, batch_size=100)
    buffer.extend(make_rows(range(20), 0))
    buffer.extend(make_rows(range(20), 1))
    for online in (70, 80, 95, 100, 0):
        buffer.sampler.set_shares({"online": online / 100, "expert": 1 - online / 100})
        assert count(buffer.sample()) == [online, 100 - online]
    with pytest.raises(ConfigError, match="online"):
        buffer.sampler.set_shares({"other": 1.0})


def test_four_sources_pass_their_shares_on_as_they_anneal():
    names = ("online", "expert", "dagger", "failed")
    start = dict(zip(names, (0.1, 0.5, 0.3, 0.1), strict=True))
    end = dict(zip(names, (0.7, 0.1, 0.1, 0.1), strict=True))
    buffer = make_buffer(dict.fromkeys(names, 50), start, batch_size=100)
    for source in range(4):
        buffer.extend(make_rows(range(20), source))
    for progress, expected in ((0.0, [10, 50, 30, 10]), (0.5, [40, 30, 20, 10]), (1.0, [70, 10, 10, 10])):
        buffer.sampler.set_shares(anneal_shares(start, end, progress))
        assert count(buffer.sample(), 4) == expected


def test_a_ring_that_wraps_leaves_the_other_source_alone():
    buffer = make_buffer({"online": 10, "expert": 5}, SHARES, batch_size=400)
    buffer.extend(make_rows([1000, 1001, 1002], 1))
    for start in range(0, 90, 7):
        buffer.extend(make_rows(range(start, start + 7), 0))
    assert len(buffer) == 13
    batch = buffer.sample()
    expert = batch["x"][batch["source"].squeeze(-1) == 1]
    online = batch["x"][batch["source"].squeeze(-1) == 0]
    assert set(expert.tolist()) == {1000, 1001, 1002}
    assert set(online.tolist()) == set(range(81, 91))


def test_mixed_sources_in_one_write_go_to_their_own_rings():
    buffer = make_buffer({"online": 4, "expert": 4}, SHARES)
    rows = TensorDict({"x": torch.arange(6.0), "source": torch.tensor([0, 1, 0, 1, 0, 1])}, [6])
    index = buffer.extend(rows)
    assert index.tolist() == [0, 4, 1, 5, 2, 6]
    assert buffer[index]["x"].tolist() == [0, 1, 2, 3, 4, 5]


def test_more_rows_than_the_capacity_keep_the_last():
    buffer = make_buffer({"online": 4, "expert": 4}, SHARES, batch_size=100)
    buffer.extend(make_rows(range(11), 0))
    assert set(buffer.sample()["x"].tolist()) == {7, 8, 9, 10}
    buffer.extend(make_rows([11], 0))
    assert set(buffer.sample()["x"].tolist()) == {8, 9, 10, 11}


def test_the_seed_reaches_the_draws():
    draws = []
    for seed in (0, 0, 1):
        buffer = make_buffer({"online": 500, "expert": 100}, SHARES, seed=seed)
        buffer.extend(make_rows(range(400), 0))
        draws.append(buffer.sample()["x"])
    assert torch.equal(draws[0], draws[1])
    assert not torch.equal(draws[0], draws[2])


@pytest.mark.parametrize("route", ["state_dict", "dumps"])
def test_a_restored_buffer_goes_on_alike(route, tmp_path):
    first = make_buffer({"online": 20, "expert": 8}, SHARES)
    first.extend(make_rows(range(33), 0))
    first.extend(make_rows(range(5), 1))
    first.sampler.set_shares({"online": 0.4, "expert": 0.6})
    first.sample()
    second = make_buffer({"online": 20, "expert": 8}, SHARES, seed=5)
    if route == "state_dict":
        second.load_state_dict(first.state_dict())
    else:
        first.dumps(tmp_path / "buffer")
        second.loads(tmp_path / "buffer")
    for _ in range(3):
        assert torch.equal(first.sample()["x"], second.sample()["x"])
        for buffer in (first, second):
            buffer.extend(make_rows(range(100, 107), 0))


def test_a_folder_that_held_more_sources_can_be_written_with_less(tmp_path):
    first, second, third = (make_buffer({"online": 20, "expert": 8}, SHARES) for _ in range(3))
    for source in (0, 1):
        first.extend(make_rows(range(5), source))
    second.extend(make_rows(range(7), 0))
    first.dumps(tmp_path)
    second.dumps(tmp_path)
    third.loads(tmp_path)
    assert third._storage.num_rows() == {"online": 7, "expert": 0}


def test_spans_name_the_sources():
    with pytest.raises(ConfigError, match="spans"):
        MixtureSampler(SHARES, spans={"online": range(4)})


def test_sampler_works_in_an_ordinary_buffer_that_wraps():
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100), sampler=MixtureSampler(SHARES), batch_size=10
    )
    generator = torch.Generator().manual_seed(0)
    for _ in range(30):
        source = torch.randint(2, (17,), generator=generator)
        buffer.extend(TensorDict({"x": torch.randn(17), "source": source}, [17]))
        expected = torch.bincount(buffer[:]["source"], minlength=2).tolist()
        assert list(buffer.sampler.num_rows().values()) == expected
        assert count(buffer.sample()) == [7, 3]


def test_emptying_forgets_every_row():
    buffer = make_buffer({"online": 10, "expert": 5}, SHARES)
    buffer.extend(make_rows(range(7), 0))
    buffer.empty()
    assert len(buffer) == 0
    buffer.extend(make_rows([42], 0))
    assert buffer.sample()["x"].unique().tolist() == [42]


def test_wrong_uses_say_what_to_do():
    with pytest.raises(ConfigError, match="capacities"):
        MixtureStorage({"online": 0})
    with pytest.raises(ConfigError, match="MixtureStorage"):
        TensorDictReplayBuffer(storage=LazyTensorStorage(4), writer=MixtureWriter())
    with pytest.raises(ConfigError, match="source"):
        make_buffer({"online": 4, "expert": 4}, SHARES).extend(make_rows([1], 2))
    plain = TensorDictReplayBuffer(storage=LazyTensorStorage(4), sampler=MixtureSampler(SHARES))
    with pytest.raises(ConfigError, match="source"):
        plain.extend(TensorDict({"x": torch.zeros(2)}, [2]))
