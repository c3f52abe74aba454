"""The buffer behind TorchRL's own collectors and environments."""

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import (
    CatTensors,
    Compose,
    PendulumEnv,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    UnsqueezeTransform,
)

from torchgrasp.data import CompactTransitions, MixtureReplayBuffer


def make_env():
    row = UnsqueezeTransform(-1, in_keys=["th", "thdot"], out_keys=["angle", "rate"], in_keys_inv=[])
    state = CatTensors(["angle", "rate"], "state")
    return TransformedEnv(PendulumEnv(), Compose(row, state, StepCounter(max_steps=7)))


def make_buffer():
    codec = CompactTransitions(points_key="state", state_keys=("step_count",), gripper_points=False)
    return MixtureReplayBuffer({"online": 50}, {"online": 1.0}, batch_size=300, codec=codec)


def make_collector(buffer=None):
    envs = SerialEnv(3, make_env)
    envs.set_seed(0)
    return Collector(envs, None, frames_per_batch=15, total_frames=90, replay_buffer=buffer)


@pytest.mark.filterwarnings("ignore")
def test_transitions_of_a_collector_are_those_it_collected():
    buffer, reference = make_buffer(), {}
    for batch in make_collector():
        buffer.extend(batch)
        for step in batch.reshape(-1).unbind(0):
            reference[step["action"].item()] = step
        sample = buffer.sample()
        for row in sample.unbind(0):
            step = reference[row["action"].item()]
            assert torch.equal(row["state"], step["state"].half().float())
            assert torch.equal(row["next", "state"], step["next", "state"].half().float())
            assert torch.equal(row["next", "step_count"], step["next", "step_count"])
            assert torch.equal(row["next", "reward"], step["next", "reward"])
    # The steps compared include truncated ones, which are no ends and have next states.
    assert sample["next", "done"].any() and not sample["next", "terminated"].any()


@pytest.mark.filterwarnings("ignore")
def test_a_collector_fills_the_buffer_itself():
    torch.manual_seed(0)
    buffer, filled = make_buffer(), make_buffer()
    for batch in make_collector():
        buffer.extend(batch)
    torch.manual_seed(0)
    for _ in make_collector(filled):
        pass
    assert len(buffer) == len(filled) > 40
    assert filled.sample()["next", "state"].shape == (300, 2)
