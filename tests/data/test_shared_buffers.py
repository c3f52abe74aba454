"""Buffers that other processes write to: their rows are drawn like rows of one's own."""

import pytest
import torch
import torch.multiprocessing as mp
from tensordict import TensorDict
from torchrl.collectors import MultiAsyncCollector, MultiSyncCollector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer, Unbounded
from torchrl.envs import (
    CatTensors,
    Compose,
    PendulumEnv,
    StepCounter,
    TensorDictPrimer,
    TransformedEnv,
    UnsqueezeTransform,
)

from torchgrasp.data import CompactTransitions, MixtureReplayBuffer, MixtureSampler, Priority
from torchgrasp.errors import TorchgraspError

pytestmark = pytest.mark.filterwarnings("ignore")

SHARES = {"online": 0.7, "expert": 0.3}


def make_env():
    source = TensorDictPrimer(source=Unbounded((1,), dtype=torch.int64), default_value=0)
    row = UnsqueezeTransform(-1, in_keys=["th", "thdot"], out_keys=["angle", "rate"], in_keys_inv=[])
    state = CatTensors(["angle", "rate"], "state")
    return TransformedEnv(PendulumEnv(), Compose(source, row, state, StepCounter(max_steps=7)))


def make_expert():
    expert = make_env().rollout(28, break_when_any_done=False)
    expert["source"].fill_(1)
    return expert


def collect(kind, buffer, frames):
    collector = kind(
        [make_env, make_env], None, frames_per_batch=40, total_frames=frames, replay_buffer=buffer
    )
    for _ in collector:
        pass
    collector.shutdown()


def count(batch):
    return torch.bincount(batch["source"].reshape(-1), minlength=2).tolist()


def test_a_shared_buffer_draws_what_collecting_processes_write(tmp_path):
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(200), sampler=MixtureSampler(SHARES), batch_size=10, shared=True
    )
    buffer.extend(make_expert())
    collect(MultiSyncCollector, buffer, 160)
    assert buffer.sampler.num_rows() == {"online": 160, "expert": 28}
    assert all(count(buffer.sample()) == [7, 3] for _ in range(10))
    buffer.extend(make_expert()[:20])  # written here, over rows of both
    assert [*buffer.sampler.num_rows().values()] == count(buffer[:])
    buffer.dumps(tmp_path)
    other = TensorDictReplayBuffer(
        storage=LazyTensorStorage(200), sampler=MixtureSampler(SHARES), batch_size=10
    )
    other.loads(tmp_path)
    torch.manual_seed(0)
    batch = buffer.sample()
    torch.manual_seed(0)
    assert torch.equal(batch["state"], other.sample()["state"])


@pytest.mark.slow
def test_a_mixture_buffer_keeps_its_shares_and_links_under_collecting_processes():
    codec = CompactTransitions(points_key="state", state_keys=("step_count",), gripper_points=False)
    buffer = MixtureReplayBuffer({"online": 60, "expert": 60}, SHARES, batch_size=100, codec=codec)
    buffer.extend(make_expert())
    collect(MultiAsyncCollector, buffer, 200)
    assert buffer.write_count > 200 and buffer.num_rows()["expert"] == 28
    assert 40 < buffer.num_rows()["online"] <= 60  # its ring has wrapped; the ends of batches are stubs
    for _ in range(5):
        batch = buffer.sample()
        assert count(batch) == [70, 30]
        assert torch.equal(batch["next", "step_count"], batch["step_count"] + 1)


def write(buffer, rows):
    buffer.extend(rows)


@pytest.mark.slow
def test_a_row_that_another_process_wrote_over_counts_as_new():
    sampler = MixtureSampler({"online": 1.0}, priority=Priority(alpha=1.0, beta=1.0, eps=1e-9))
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(10), sampler=sampler, batch_size=1000, shared=True
    )
    rows = TensorDict({"x": torch.arange(10.0), "source": torch.zeros(10, 1).long()}, [10])
    buffer.extend(rows)
    buffer.update_priority(torch.arange(10), torch.tensor([4.0] + [1e-6] * 9))
    assert buffer.sample()["x"].unique().tolist() == [0.0]
    writer = mp.get_context("spawn").Process(target=write, args=(buffer, rows[:3] + 0))
    writer.start()
    writer.join()
    assert writer.exitcode == 0
    drawn = torch.bincount(buffer.sample()["x"].long(), minlength=10)
    assert drawn[:3].tolist() == pytest.approx([1000 / 3] * 3, abs=2) and drawn[3:].sum() < 2


def test_an_empty_mixture_buffer_is_refused_before_anything_is_collected():
    codec = CompactTransitions(points_key="state", state_keys=(), gripper_points=False)
    buffer = MixtureReplayBuffer({"online": 60, "expert": 60}, SHARES, batch_size=100, codec=codec)
    with pytest.raises(TorchgraspError, match="without rows was given to other processes: extend it first"):
        collect(MultiSyncCollector, buffer, 40)
