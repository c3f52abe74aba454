"""Prioritised replay (Schaul et al. 2016) within exact shares."""

import json

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.scheduler import LinearScheduler

from torchgrasp.data import (
    CompactTransitions,
    MixtureReplayBuffer,
    MixtureSampler,
    MixtureStorage,
    MixtureWriter,
    Priority,
)
from torchgrasp.data.priorities import PriorityPool
from torchgrasp.data.sum_tree import SumTree
from torchgrasp.errors import ConfigError

FULL = Priority(alpha=1.0, beta=1.0, eps=1e-9)


def make_buffer(shares, *, priority=FULL, capacity=100, batch_size=200, seed=0):
    return TensorDictReplayBuffer(
        storage=MixtureStorage(dict.fromkeys(shares, capacity)),
        sampler=MixtureSampler(shares, priority=priority),
        writer=MixtureWriter(),
        collate_fn=lambda batch: batch,
        batch_size=batch_size,
        generator=torch.Generator().manual_seed(seed),
    )


def make_ordinary(priority=FULL, capacity=50, batch_size=200):
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(capacity),
        sampler=MixtureSampler({"online": 0.5, "expert": 0.5}, priority=priority),
        batch_size=batch_size,
        generator=torch.Generator().manual_seed(0),
    )


def make_rows(values, source, stub=False):
    x = torch.as_tensor(values, dtype=torch.float32)
    count = len(x)
    columns = {"x": x, "source": torch.full((count, 1), source), "stub": torch.full((count, 1), stub)}
    return TensorDict(columns, [count])


def draw_counts(buffer, batches, size):
    rows = torch.cat([buffer.sample()["index"] for _ in range(batches)])
    return torch.bincount(rows, minlength=size).double()


def test_places_of_the_sum_tree_are_found_where_the_running_sum_passes():
    generator = torch.Generator().manual_seed(0)
    weights = torch.randint(0, 4, (40_000,), generator=generator).double()
    tree = SumTree()
    tree.set(torch.arange(40_000), weights)
    running = weights.cumsum(0)
    assert tree.total == running[-1]
    masses = torch.rand(3000, generator=generator, dtype=torch.float64) * tree.total
    assert torch.equal(tree.find(masses), torch.searchsorted(running, masses, right=True))


def test_the_sum_tree_stays_exact_under_changes():
    generator, tree = torch.Generator().manual_seed(1), SumTree()
    expected = torch.zeros(20_000, dtype=torch.float64)
    for size in (10, 500, 20_000):
        for _ in range(40):
            places = torch.randint(size, (250,), generator=generator)
            weights = places.double() % 7 * torch.rand(1, generator=generator, dtype=torch.float64)
            tree.set(places, weights)
            expected[places] = weights
            assert tree.total == pytest.approx(expected.sum().item(), rel=1e-12)
    found = tree.find(torch.tensor([0.0, tree.total, 2 * tree.total]))
    assert (expected[found] > 0).all()


def test_rows_are_drawn_in_proportion_to_their_errors_and_shares_are_exact():
    buffer = make_buffer({"online": 0.75, "expert": 0.25})
    online = buffer.extend(make_rows(range(20), 0))
    expert = buffer.extend(make_rows(range(10), 1))
    errors = torch.cat((torch.arange(1.0, 21), torch.tensor([9.0] + [1.0] * 9)))
    buffer.update_priority(torch.cat((online, expert)), errors)
    counts = draw_counts(buffer, 400, 200)
    assert counts[:100].sum() == 400 * 150 and counts[100:].sum() == 400 * 50
    expected = torch.zeros(200, dtype=torch.float64)
    expected[:20] = 400 * 150 * torch.arange(1.0, 21) / 210
    expected[100:110] = 400 * 50 * torch.tensor([9.0] + [1.0] * 9) / 18
    drawn = expected > 0
    assert counts[~drawn].sum() == 0
    # 30 rows; 5 % of independent draws exceed 42, slices are more even.
    assert ((counts - expected)[drawn] ** 2 / expected[drawn]).sum() < 42


def test_a_batch_may_be_too_small_for_every_source():
    buffer = make_buffer({"online": 0.7, "expert": 0.3})
    buffer.extend(make_rows(range(20), 0))
    buffer.extend(make_rows(range(10), 1))
    batch = buffer.sample(1)
    assert batch["source"].tolist() == [[0]] and batch["priority_weight"].tolist() == [1.0]


def test_alpha_flattens_the_preference():
    for alpha, share in ((0.0, 1 / 2), (0.5, 2 / 3), (1.0, 4 / 5)):
        buffer = make_buffer({"online": 1.0}, priority=Priority(alpha=alpha, eps=1e-9))
        buffer.update_priority(buffer.extend(make_rows([0, 1], 0)), torch.tensor([1.0, 4.0]))
        counts = draw_counts(buffer, 50, 2)
        assert counts[1] / counts.sum() == pytest.approx(share, abs=0.01)


def test_weights_by_hand():
    # P = 1/8, 3/8, 4/8 of 3 rows: N P = 3/8, 9/8, 12/8, their inverses by the largest: 1, 1/3, 1/4.
    buffer = make_buffer({"online": 1.0})
    buffer.update_priority(buffer.extend(make_rows([0, 1, 2], 0)), torch.tensor([1.0, 3.0, 4.0]))
    batch = buffer.sample()
    wanted = torch.tensor([1.0, 1 / 3, 1 / 4])
    assert batch["priority_weight"].dtype == torch.float32
    assert torch.allclose(batch["priority_weight"], wanted[batch["index"]], atol=1e-6)
    buffer.sampler.beta = 0.5
    batch = buffer.sample()
    assert torch.allclose(batch["priority_weight"], wanted[batch["index"]].sqrt(), atol=1e-6)


def test_weights_make_the_mean_of_each_source_that_of_a_uniform_draw():
    buffer = make_buffer({"online": 0.5, "expert": 0.5}, batch_size=400)
    values = torch.arange(50.0)
    for source, errors in ((0, 1 + values % 5), (1, 100 * (1 + values % 3))):
        buffer.update_priority(buffer.extend(make_rows(values, source)), errors)
    batch = torch.cat([buffer.sample() for _ in range(50)])
    by_source = [batch[batch["source"].squeeze(-1) == source] for source in (0, 1)]
    sums = [rows["priority_weight"].sum() for rows in by_source]
    for rows, total in zip(by_source, sums, strict=True):
        assert (rows["x"] * rows["priority_weight"]).sum() / total == pytest.approx(24.5, rel=0.02)
    # Equal shares stay equal, however much larger the errors of one source are.
    assert sums[0] / sums[1] == pytest.approx(1.0, rel=0.02)


def test_errors_go_back_to_the_rows_of_a_batch_in_any_buffer():
    for buffer in (make_buffer({"online": 1.0, "expert": 0.0}), make_ordinary()):
        buffer.extend(make_rows(range(8), 0))
        batch = buffer.sample()
        assert set(batch["x"].tolist()) == set(range(8))
        buffer.update_priority(batch["index"], torch.where(batch["x"] == 5, 10.0, 0.0))
        assert (buffer.sample()["x"] == 5).float().mean() > 0.99


def make_mixture(priority):
    """A MixtureReplayBuffer of one episode of eight steps, told apart by their time left."""
    buffer = MixtureReplayBuffer(
        {"online": 20},
        {"online": 1.0},
        batch_size=200,
        priority=priority,
        codec=CompactTransitions(points_key=None, gripper_points=False),
    )
    time_left, done = 1.0 - torch.arange(8.0)[:, None] / 8, torch.arange(8)[:, None] == 7
    ends = {"done": done, "terminated": done, "reward": torch.zeros(8, 1)}
    following = {"time_left": time_left - 1 / 8, **ends}
    buffer.extend(TensorDict({"time_left": time_left, "action": torch.zeros(8, 6), "next": following}, [8]))
    return buffer


@pytest.mark.parametrize("shape", [(200,), (200, 1), (200, 2)])
def test_a_mixture_buffer_takes_the_largest_error_that_a_loss_wrote_for_each_row(shape):
    buffer = make_mixture(FULL)
    batch = buffer.sample()
    errors = torch.zeros(shape)
    errors.view(200, -1)[:, -1] = torch.where(batch["time_left"] == 0.5, 10.0, 0.0).squeeze(-1)
    buffer.update_tensordict_priority(batch.set("td_error", errors))
    assert (buffer.sample()["time_left"] == 0.5).float().mean() > 0.99


def test_a_batch_without_errors_is_refused_where_they_count():
    buffer = make_mixture(FULL)
    with pytest.raises(ConfigError, match="td_error"):
        buffer.update_tensordict_priority(buffer.sample())
    uniform = make_mixture(None)
    uniform.update_tensordict_priority(uniform.sample())


def test_new_rows_and_rows_written_again_count_as_the_largest_error():
    buffer = make_buffer({"online": 1.0}, capacity=4)
    buffer.update_priority(buffer.extend(make_rows(range(4), 0)), torch.tensor([1.0, 1.0, 1.0, 5.0]))
    buffer.update_priority(torch.tensor([3]), torch.tensor([1.0]))
    assert buffer.extend(make_rows([4], 0)).tolist() == [0]
    counts = draw_counts(buffer, 100, 4)
    assert (counts / counts.sum()).tolist() == pytest.approx([5 / 8, 1 / 8, 1 / 8, 1 / 8], abs=0.01)


def test_stubs_are_never_drawn_whatever_error_they_are_given():
    buffer = make_buffer({"online": 1.0}, capacity=6)
    index = buffer.extend(torch.cat((make_rows([0, 1], 0), make_rows([2], 0, stub=True))))
    buffer.update_priority(index, torch.tensor([1.0, 1.0, 1e6]))
    assert set(buffer.sample()["x"].tolist()) == {0, 1}
    # A stub takes the place of the row with the largest error.
    buffer.update_priority(torch.tensor([0]), torch.tensor([1e6]))
    buffer.extend(torch.cat((make_rows([3, 4, 5], 0), make_rows([6], 0, stub=True))))
    assert set(buffer.sample()["x"].tolist()) <= {1, 3, 4, 5}
    buffer.update_priority(torch.tensor([0]), torch.tensor([1e9]))
    assert set(buffer.sample()["x"].tolist()) <= {1, 3, 4, 5}


def test_rows_that_change_their_source_take_no_weight_along():
    buffer = make_ordinary(capacity=4)
    buffer.update_priority(buffer.extend(make_rows(range(4), 0)), torch.tensor([1.0, 2.0, 3.0, 4.0]))
    buffer.extend(make_rows([7, 8], 1))  # over rows 0 and 1
    batch = buffer.sample()
    assert torch.bincount(batch["source"].reshape(-1)).tolist() == [100, 100]
    online = batch["index"][:100]
    assert (online == 3).float().mean() == pytest.approx(4 / 7, abs=0.02)
    assert set(batch["x"][100:].tolist()) == {7, 8}


def test_a_pool_keeps_the_weights_of_its_members_under_any_changes():
    generator, pool, expected = torch.Generator().manual_seed(2), PriorityPool(), {}
    for _ in range(150):
        rows = torch.randperm(600, generator=generator)[:40]
        pool.add(rows[:20])
        expected |= dict.fromkeys(rows[:20].tolist(), pool.largest or 1.0)
        pool.remove(rows[20:])
        for row in rows[20:].tolist():
            expected.pop(row, None)
        weights = torch.rand(20, generator=generator, dtype=torch.float64)
        pool.set_weights(rows[10:30], weights)
        for row, weight in zip(rows[10:30].tolist(), weights.tolist(), strict=True):
            if row in expected:
                expected[row] = weight
        assert dict(zip(pool.members.tolist(), pool.weights.tolist(), strict=True)) == expected


@pytest.mark.parametrize("route", ["state_dict", "dumps"])
def test_a_restored_buffer_draws_and_weighs_alike(route, tmp_path):
    shares = {"a": 0.4, "b": 0.3, "c": 0.2, "d": 0.1}
    first, second = make_buffer(shares, seed=3), make_buffer(shares, seed=4)
    for source in range(4):
        index = first.extend(make_rows(range(37), source))
        first.update_priority(index, torch.arange(37.0) + source)
    first.sampler.beta = 0.7
    if route == "state_dict":
        state = first.state_dict()
        json.dumps({name: state["_sampler"][name] for name in ("largest", "beta")})
        second.load_state_dict(state)
    else:
        first.dumps(tmp_path)
        second.loads(tmp_path)
    for _ in range(3):
        batches = [buffer.sample() for buffer in (first, second)]
        assert (batches[0] == batches[1]).all()
        assert torch.bincount(batches[0]["source"].reshape(-1)).tolist() == [80, 60, 40, 20]
        for buffer in (first, second):
            buffer.extend(make_rows(range(5), 2))
            buffer.update_priority(batches[0]["index"], batches[0]["x"])
    with pytest.raises(ConfigError, match="without a priority"):
        second.sampler.load_state_dict(make_buffer(shares, priority=None).sampler.state_dict())


def test_a_folder_that_held_priorities_can_be_written_without_them(tmp_path):
    shares = {"online": 0.5, "expert": 0.5}
    for priority in (FULL, None, FULL):
        buffer, again = (make_buffer(shares, priority=priority) for _ in range(2))
        for source in (0, 1):
            buffer.extend(make_rows(range(6), source))
        buffer.dumps(tmp_path)
        again.loads(tmp_path)
        assert again.sampler.num_rows() == {"online": 6, "expert": 6}
        assert torch.equal(buffer.sample()["x"], again.sample()["x"])


def test_torchrls_scheduler_anneals_beta():
    buffer = make_buffer({"online": 1.0}, priority=Priority(beta=0.4))
    scheduler = LinearScheduler(buffer, param_name="beta", final_value=1.0, num_steps=3)
    found = []
    for _ in range(4):
        scheduler.step()
        found.append(buffer.sampler.beta)
    assert found == pytest.approx([0.6, 0.8, 1.0, 1.0])


def test_without_a_priority_errors_change_nothing():
    buffer = make_buffer({"online": 1.0}, priority=None)
    buffer.extend(make_rows(range(4), 0))
    batch = buffer.sample()
    buffer.update_priority(batch["index"], torch.rand(200))
    assert batch.get("priority_weight", None) is None
    assert set(buffer.sampler.state_dict()) == {"shares", "rows"}


@pytest.mark.parametrize("options", [{"alpha": 1.5}, {"beta": -0.1}, {"eps": 0.0}])
def test_wrong_priorities_are_refused(options):
    with pytest.raises(ConfigError, match=f"^{next(iter(options))}="):
        Priority(**options)


def test_errors_that_are_no_numbers_are_refused():
    buffer = make_buffer({"online": 1.0})
    index = buffer.extend(make_rows(range(2), 0))
    with pytest.raises(ConfigError, match="NaN"):
        buffer.update_priority(index, torch.tensor([1.0, float("nan")]))
