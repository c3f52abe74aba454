"""The environment in TorchRL's batches and collectors, in this process and in others."""

import contextlib
import os
import signal
from functools import partial

import pytest
import torch
from torchrl.collectors import Collector, MultiSyncCollector
from torchrl.envs import ParallelEnv, SerialEnv

from tests.envs.processes import make_cloud_env, make_env

pytestmark = pytest.mark.filterwarnings("ignore")

WORKERS = [partial(make_cloud_env, first_world=0), partial(make_cloud_env, first_world=1)]


def idle(tensordict):
    return tensordict.set("action", torch.full((*tensordict.batch_size, 6), 0.01))


def same_worlds(a, b) -> None:
    for key in ("joints", "T_base_object", "points", "num_points", "world", ("next", "points")):
        assert torch.equal(a.get(key), b.get(key)), key


@pytest.fixture(scope="module")
def expected():
    """(2 worlds, 3 steps), from one environment of two worlds."""
    return make_cloud_env(2).rollout(3, idle)


def test_serial_env_shares_out_the_same_worlds(expected):
    steps = SerialEnv(2, WORKERS).rollout(3, idle)
    assert steps.shape == (2, 1, 3)
    same_worlds(steps.squeeze(1), expected)


def test_parallel_env_shares_out_the_same_worlds(expected):
    env = ParallelEnv(2, WORKERS)
    try:
        same_worlds(env.rollout(3, idle).squeeze(1), expected)
    finally:
        env.close()


def test_a_collector_goes_through_episodes_one_after_another():
    collector = Collector(make_cloud_env(2), idle, frames_per_batch=12, total_frames=36)
    batches = list(collector)
    collector.shutdown()
    steps = torch.cat(batches, dim=-1)
    assert steps.shape == (2, 18)
    assert steps["episode"][0, :, 0].tolist() == [i // 3 for i in range(18)]
    assert torch.equal(steps["next", "done"][..., 0], (torch.arange(18) % 3 == 2).expand(2, 18))
    # What follows a step is what the next step starts from, within an episode.
    within = ~steps["next", "done"][0, :-1, 0]
    after, before = steps["next", "points"][:, :-1], steps["points"][:, 1:]
    assert torch.equal(after[:, within], before[:, within])


@pytest.mark.slow
def test_two_collecting_processes_share_out_the_same_worlds(expected):
    collector = MultiSyncCollector(WORKERS, idle, frames_per_batch=6, total_frames=6, cat_results="stack")
    try:
        (batch,) = list(collector)
    finally:
        collector.shutdown()
    order = batch["world"].flatten(1)[:, 0].argsort()
    same_worlds(batch[order].reshape(2, 3), expected)


def test_random_actions_run_without_a_policy():
    collector = Collector(make_env(2), None, frames_per_batch=6, total_frames=6)
    (batch,) = list(collector)
    collector.shutdown()
    assert batch["action"].abs().amax() > 0.01


def test_a_worker_that_dies_is_an_error_and_no_hang():
    env = ParallelEnv(2, WORKERS, mp_start_method="spawn")
    state = env.rand_step(env.reset())["next"]
    os.kill(env._workers[1].pid, signal.SIGKILL)
    with pytest.raises(RuntimeError, match="worker 1 dead"):
        env.rand_step(state.clone())
    for worker in env._workers:
        with contextlib.suppress(ValueError):  # TorchRL has closed the dead one
            worker.terminate()
            worker.join()
    env.is_closed = True
