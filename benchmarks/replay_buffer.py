"""suite=replay: the replay buffer when it is full: bytes, time to fill, to draw, to save and to read back."""

from __future__ import annotations

import gc
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase

from torchgrasp import keys
from torchgrasp.data import CompactTransitions, MixtureReplayBuffer, MixtureSampler, Priority, estimate_bytes
from torchgrasp.data.buffer_memory import check_space
from torchgrasp.errors import ConfigError, check_whole
from torchgrasp.geometry import ACTION_SIZE, gripper_control_points
from torchgrasp.runs import Progress, load_checkpoint, save_checkpoint

# Sec. 6.4: 1,024 points, batches of 250, of which 30 % are of 50,000 demonstrated steps beside 2 million.
_NUM_POINTS, _BATCH, _SHARES, _EXPERT_PART = 1024, 250, {"online": 0.7, "expert": 0.3}, 40
_HORIZON, _CHUNK = 30, 100
# Draws that meet memory which the process has not touched yet.
_WARM_UP = 5


def benchmark_replay(cfg: DictConfig) -> dict:
    """A buffer of `transitions`, in memory or below `replay_folder`, and one that is read back from disk."""
    check_whole("transitions", cfg.transitions, _EXPERT_PART * _HORIZON)
    size = estimate_bytes(cfg.transitions, num_points=_NUM_POINTS, prioritised=True)
    print(f"{cfg.transitions} transitions take {size / 1e9:.2f} GB, and as much of disk when they are saved")
    with _scratch(str(cfg.output_dir)) as scratch:
        check_space(cfg.transitions, size // cfg.transitions, folder=scratch)
        saved = scratch / "checkpoint"
        # The first buffer is given up before the second takes as much.
        row, expected = _measure_first(cfg, saved)
        gc.collect()
        row |= _measure_second(cfg, saved, expected)
    _print_row(row)
    return {"replay": row}


def _measure_first(cfg: DictConfig, saved: Path) -> tuple[dict, list[TensorDictBase]]:
    """Fill, draw and save as a run's checkpoint does; returns the figures and the batches that come next."""
    with _scratch(cfg.replay_folder) as home:
        buffer = _make_buffer(cfg, home)
        row = {"transitions": cfg.transitions, "folder": cfg.replay_folder}
        row["build_seconds"] = _seconds(lambda: _fill(buffer, cfg.transitions))
        row["bytes_per_transition"] = buffer.num_bytes() / cfg.transitions
        row |= _time_draws(buffer, cfg.draws)
        row["save_seconds"] = _seconds(lambda: save_checkpoint(saved, {"buffer": buffer.state_dict()}))
        row["saved_bytes"] = sum(file.stat().st_size for file in saved.iterdir())
        return row, [buffer.sample() for _ in range(3)]


def _measure_second(cfg: DictConfig, saved: Path, expected: list[TensorDictBase]) -> dict:
    """Read what was saved, and compare the batches that come next with the `expected`."""
    with _scratch(cfg.replay_folder) as home:
        buffer = _make_buffer(cfg, home)
        seconds = _seconds(lambda: buffer.load_state_dict(load_checkpoint(saved)["buffer"]))
        if not all(bool((batch == buffer.sample()).all()) for batch in expected):
            raise ConfigError("Batches of the buffer that was read back differ: report this with versions.")
    return {"reload_seconds": seconds, "equal_after_reload": True}


@contextmanager
def _scratch(parent: str | None) -> Iterator[Any]:
    """A folder below `parent` while the block lasts; None where there is no parent."""
    if parent is None:
        yield None
        return
    Path(parent).mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".replay_", dir=parent) as folder:
        yield Path(folder)


def _make_buffer(cfg: DictConfig, folder: Path | None) -> MixtureReplayBuffer:
    expert = cfg.transitions // _EXPERT_PART
    cloud = (_NUM_POINTS + len(gripper_control_points()), 4)
    return MixtureReplayBuffer(
        {"online": cfg.transitions - expert, "expert": expert},
        _SHARES,
        batch_size=_BATCH,
        seed=cfg.seed,
        folder=folder,
        priority=Priority(),
        row=CompactTransitions().example_row({keys.POINTS: cloud, keys.TIME_LEFT: (1,)}),
    )


def _fill(buffer: MixtureReplayBuffer, transitions: int) -> None:
    """Fill both sources with whole episodes, as collectors hand them over; the last may be short."""
    generator = torch.Generator().manual_seed(0)
    expert = transitions // _EXPERT_PART
    progress = Progress(transitions, description="filling", unit="step")
    for source, wanted in (("expert", expert), ("online", transitions - expert)):
        for steps in _make_steps(wanted, generator):
            buffer.extend(steps, source=source)
            progress.update(steps.numel())
    progress.close()


def _make_steps(count: int, generator: torch.Generator) -> Iterator[TensorDict]:
    """`count` steps (B, T) of random clouds the size of an object, in episodes of 30."""
    while count:
        horizon = min(_HORIZON, count)
        episodes = min(_CHUNK, count // horizon)
        count -= episodes * horizon
        yield _make_episodes(episodes, horizon, generator)


def _make_episodes(episodes: int, horizon: int, generator: torch.Generator) -> TensorDict:
    tail = gripper_control_points()
    cloud = torch.zeros(episodes, horizon + 1, _NUM_POINTS + len(tail), 4)
    cloud[:, :, :_NUM_POINTS, :3] = torch.rand(episodes, horizon + 1, _NUM_POINTS, 3, generator=generator)
    cloud[:, :, _NUM_POINTS:, :3], cloud[:, :, _NUM_POINTS:, 3] = tail, 1.0
    time_left = 1.0 - torch.arange(horizon + 1.0).expand(episodes, -1)[..., None] / horizon
    done = (torch.arange(horizon) == horizon - 1).expand(episodes, -1)[..., None]
    success = done * (torch.rand(episodes, 1, 1, generator=generator) < 0.5)
    ends = {"done": done, "terminated": done, "reward": success.float()}
    following = {keys.POINTS: cloud[:, 1:], keys.TIME_LEFT: time_left[:, 1:], **ends}
    state = {keys.POINTS: cloud[:, :-1], keys.TIME_LEFT: time_left[:, :-1]}
    action = torch.rand(episodes, horizon, ACTION_SIZE, generator=generator)
    return TensorDict({**state, keys.ACTION: action, "next": following}, [episodes, horizon])


def _time_draws(buffer: MixtureReplayBuffer, draws: int) -> dict:
    """Milliseconds of a batch, and of handing its errors back, by priority and uniformly."""
    prioritised, uniform = buffer.sampler, MixtureSampler(_SHARES)
    state = prioritised.state_dict()
    uniform.load_state_dict({"shares": state["shares"], "rows": state["rows"]})
    row = _time_sampler("prioritised", buffer, draws)
    buffer.set_sampler(uniform)
    row |= _time_sampler("uniform", buffer, draws)
    buffer.set_sampler(prioritised)
    return row


def _time_sampler(name: str, buffer: MixtureReplayBuffer, draws: int) -> dict:
    """Milliseconds by the clock and of computing; a batch is held until the next is there."""
    generator = torch.Generator().manual_seed(1)
    found, computing, updates = [], [], []
    for _ in range(draws + _WARM_UP):
        start, computed = time.perf_counter(), time.thread_time()
        batch = buffer.sample()
        found.append(time.perf_counter() - start)
        computing.append(time.thread_time() - computed)
        batch["td_error"] = torch.rand(_BATCH, generator=generator)
        start = time.perf_counter()
        buffer.update_tensordict_priority(batch)
        updates.append(time.perf_counter() - start)
    found, computing, updates = (1e3 * np.array(each[_WARM_UP:]) for each in (found, computing, updates))
    return {
        f"{name}_median_milliseconds": float(np.median(found)),
        f"{name}_p95_milliseconds": float(np.percentile(found, 95)),
        f"{name}_computing_milliseconds": float(np.median(computing)),
        f"{name}_update_milliseconds": float(np.median(updates)),
    }


def _seconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def _print_row(row: dict) -> None:
    place = "memory" if row["folder"] is None else row["folder"]
    print(
        f"{row['transitions']} transitions in {place}: {row['bytes_per_transition']:.0f} bytes each, "
        f"filled in {row['build_seconds']:.1f} s; saved in {row['save_seconds']:.1f} s as "
        f"{row['saved_bytes'] / 1e9:.2f} GB, read back in {row['reload_seconds']:.1f} s, then with the same "
        "batches"
    )
    for name in ("uniform", "prioritised"):
        words = ("median", "p95", "computing", "update")
        median, p95, computing, update = (row[f"{name}_{word}_milliseconds"] for word in words)
        print(
            f"  {name:11s} {median:.2f} ms a batch of {_BATCH} (95 %: {p95:.2f}, computing {computing:.2f}); "
            f"errors back in {update:.2f} ms"
        )
