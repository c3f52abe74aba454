"""suite=scale: time and memory of updates and rollouts as batches, points and workers grow, one at a time."""

from __future__ import annotations

import ctypes
import gc
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from itertools import chain

import psutil
import torch
from composition import compose_config
from learner_updates import list_updates, measure_seconds
from network_passes import peak_megabytes
from omegaconf import DictConfig
from tensordict.nn import TensorDictSequential
from update_pass import make_batch

from torchgrasp.config import (
    build,
    make_actor_critic,
    make_expert,
    make_pool,
    prepare_objects,
    training_config,
)
from torchgrasp.geometry import gripper_control_points
from torchgrasp.processes import count_cores
from torchgrasp.rollouts.episode_pool import Policy, copy_for_rollouts
from torchgrasp.rollouts.process_pool import COPIES, start_server
from torchgrasp.runs import seed_everything

_KINDS = ("imitation", "critic", "actor")
_WORKERS = (1, 2, 4, 8, 15)
# Before the first update that is timed: CUDA graphs are recorded after four.
_WARM_UP = {"cpu": 2, "cuda": 6}
# Of glibc's malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3


def benchmark_scale(cfg: DictConfig) -> list[dict]:
    """A row for each kind of update and size, and one for each number of workers."""
    rows = []
    for row in chain(_measure_updates(cfg), _measure_workers(cfg)):
        rows.append({"experiment": cfg.scale.experiment, **row})
        print(_tell(row), flush=True)
    return rows


def _measure_updates(cfg: DictConfig) -> Iterator[dict]:
    """Each kind at each size."""
    for over, name, sizes in (
        ("batch", "replay.batch_size", cfg.scale.batches),
        ("points", "num_points", cfg.scale.points),
    ):
        for size in sizes:
            chosen = _compose(cfg, f"{name}={size}", f"device={cfg.device}")
            row = {"over": over, "batch": chosen.replay.batch_size, "points": chosen.num_points}
            for kind in _KINDS:
                found = _measure_alone(chosen, kind, cfg.scale.repeats)
                yield {"what": kind, "device": cfg.device, **row, **found}


def _measure_workers(cfg: DictConfig) -> Iterator[dict]:
    """Each number of workers."""
    counts = choose_workers(cfg.scale.workers, count_cores())
    if not counts:
        return
    chosen = _compose(cfg)
    prepare_objects(chosen, "train")
    policy = _make_policy(chosen)
    for workers in counts:
        row = measure_rollouts(chosen, policy, workers, cfg.scale.rounds)
        yield {"what": "rollouts", "device": "cpu", "over": "workers", "workers": workers, **row}


def _compose(cfg: DictConfig, *overrides: str) -> DictConfig:
    given = [f"experiment={cfg.scale.experiment}", *cfg.scale.overrides, f"seed={cfg.seed}", *overrides]
    return training_config(compose_config("td3_bc", given), "td3_bc")


def _measure_alone(chosen: DictConfig, kind: str, repeats: int) -> dict[str, float]:
    """Measure in a process of its own on a CPU, whose largest memory is then this update's."""
    if torch.device(chosen.device).type == "cuda":  # its memory can be counted anew
        return measure_update(chosen, kind, repeats)
    start_server()  # copies of which have imported torch: seconds less for each
    with ProcessPoolExecutor(1, mp_context=COPIES) as alone:
        return alone.submit(measure_update, chosen, kind, repeats).result()


def measure_update(chosen: DictConfig, kind: str, repeats: int) -> dict[str, float]:
    """Least milliseconds of an update, and the megabytes of learner, batch and update together."""
    torch.set_num_threads(1)
    device = torch.device(chosen.device)
    _make_update(chosen, kind, batch=2)()  # loads what is loaded at first use
    gc.collect()
    if device.type == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    before = peak_megabytes(device)
    with _nothing_kept():
        update = _make_update(chosen, kind, batch=chosen.replay.batch_size)
        for _ in range(_WARM_UP.get(device.type, 2)):
            update()
    megabytes = peak_megabytes(device) - before
    update()
    seconds = min(measure_seconds(update, device, 1) for _ in range(repeats))
    return {"milliseconds": 1e3 * seconds, "megabytes": megabytes}


def _make_update(chosen: DictConfig, kind: str, *, batch: int) -> Callable[[], None]:
    """An update of a new learner on one batch."""
    seed_everything(chosen.seed)
    learner = make_actor_critic(chosen)
    learner.copy_to_targets()
    learner.set_rate(chosen.online.learning_rate)
    points = chosen.num_points + len(gripper_control_points())
    return list_updates(learner, make_batch(batch, points).to(chosen.device))[kind]


@contextmanager
def _nothing_kept() -> Iterator[None]:
    """Let glibc return large blocks to the system at once, so that resident memory is what is in use.

    It otherwise keeps some for the next request, more or less of them as sizes have it.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", lambda *_: 0)
    mallopt(_MMAP_THRESHOLD, 1 << 17)
    try:
        yield
    finally:  # where its own adjustment would have ended
        mallopt(_MMAP_THRESHOLD, 1 << 25)
        mallopt(_TRIM_THRESHOLD, 1 << 26)


def _make_policy(chosen: DictConfig) -> Policy:
    """What acts and labels in td3_bc's online phase, but for the expert's beginnings."""
    seed_everything(chosen.seed)
    modules: list = [make_expert(chosen, "train", execute=False), make_actor_critic(chosen).actor]
    return copy_for_rollouts(TensorDictSequential(*modules, build(chosen.collector.noise)))


def choose_workers(given: Sequence[int] | None, cores: int) -> list[int]:
    """The numbers of workers given, or those that there are cores for."""
    return [each for each in _WORKERS if each <= cores] if given is None else list(given)


def measure_rollouts(chosen: DictConfig, policy: Policy, workers: int, rounds: int) -> dict[str, float]:
    """Env steps a second of `rounds` groups of worlds a worker, and megabytes of all that was started."""
    chosen = chosen.copy()
    chosen.collector.num_workers = workers
    with make_pool(chosen) as pool:
        list(pool.run("train", policy, range(workers), explore=True))  # makes the environments
        start, steps = time.perf_counter(), 0
        for episodes in pool.run("train", policy, range(workers, (1 + rounds) * workers), explore=True):
            steps += sum(len(episode.steps) for episode in episodes)
        seconds = time.perf_counter() - start
        return {"env_steps_per_second": steps / seconds, "megabytes": _measure_children()}


def _measure_children() -> float:
    """Megabytes of the processes started from here, pages that they share counted once where that is told."""
    found = [child.memory_full_info() for child in psutil.Process().children(recursive=True)]
    return sum(getattr(each, "pss", each.rss) for each in found) / 2**20


def _tell(row: dict) -> str:
    if "workers" in row:
        return (
            f"scale {row['workers']:2d} workers: {row['env_steps_per_second']:.0f} env steps/s, "
            f"{row['megabytes']:.0f} MB"
        )
    return (
        f"scale {row['what']:9} {row['batch']:4d} x {row['points']:4d} points on {row['device']}: "
        f"{row['milliseconds']:.1f} ms, {row['megabytes']:.0f} MB"
    )
