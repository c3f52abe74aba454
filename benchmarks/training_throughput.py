"""suite=training: rollouts and updates of td3_bc's online phase, by who collects, workers and overlap."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from composition import compose_config
from omegaconf import DictConfig
from who_waits import tell_who_waits

from torchgrasp.config import Run, gather_sources, make_actor_critic, training_config
from torchgrasp.config.main_phase import count_rounds, describe_idle_workers
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.learning_curves import read_metrics
from torchgrasp.recipes.td3_bc import (  # pyright: ignore[reportMissingImports]  recipes/ as installed
    make_actors,
    reinforce,
)
from torchgrasp.rollouts.episode_pool import copy_for_rollouts
from torchgrasp.runs import seed_everything

# Heading -> its width, and the figure below it with its digits.
_COLUMNS: dict[str, tuple[int, str, int]] = {
    "env steps/s": (11, "env_steps_per_second_of_both", 0),
    "updates/s": (9, "updates_per_second", 1),
    "iteration, s": (12, "iteration_seconds", 2),
    "learner waits, s": (16, "learner_waits_seconds", 2),
    "a worker waits, s": (17, "worker_waits_seconds", 2),
    "ms an env step": (14, "env_step_milliseconds", 2),
    "ms an update": (12, "update_milliseconds", 1),
}


def benchmark_training(cfg: DictConfig) -> dict[str, dict]:
    """A row for each collector and number of workers, and one more where collecting overlaps with learning.

    The loop is td3_bc's own, and so are the figures: what it writes into metrics.csv.
    """
    if not cfg.training.workers:
        raise ConfigError("training.workers=[]: give at least one number of workers, such as [0,1,2].")
    rows: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, overrides in _list_variants(cfg):
            rows[name] = _measure(_compose(cfg, *overrides), cfg.training.warmup, Path(folder))
            print(f"{name}: {rows[name]['iteration_seconds']:.1f} s an iteration", flush=True)
    _print_table(rows)
    return rows


def _list_variants(cfg: DictConfig) -> Iterator[tuple[str, list[str]]]:
    """Names and overrides: every number of workers of every collector, and with any overlapping as well."""
    for workers in cfg.training.workers:
        for collector in cfg.training.collectors if workers else ["serial"]:
            name = f"{collector} {workers}" if workers else collector
            given = [f"collector={collector}", f"collector.num_workers={workers}"]
            yield name, [*given, "collector.overlap=false"]
            if workers:
                yield f"{name}, overlapping", [*given, "collector.overlap=true"]


def _compose(cfg: DictConfig, *overrides: str) -> DictConfig:
    """The configuration of td3_bc.py, long enough for the iterations and without checkpoints between."""
    chosen = compose_config("td3_bc", [*cfg.training.overrides, *overrides])
    steps = count_rounds(chosen) * chosen.env.num_envs * chosen.env.horizon
    chosen.total_env_steps = (cfg.training.warmup + cfg.training.iterations) * steps
    chosen.checkpoint.iterations = 10**9
    chosen.evaluation.num_objects = 1  # nothing is evaluated, but a run prepares these objects too
    chosen.seed, chosen.device = cfg.seed, cfg.device
    return training_config(chosen, "td3_bc")


def _measure(chosen: DictConfig, warmup: int, folder: Path) -> dict:
    """One run of the online phase below `folder`, where all runs share their demonstrations."""
    chosen.output_dir = str(folder)
    seed_everything(chosen.seed)
    with Run(chosen, make_actor_critic(chosen)) as run:
        run.begin(gather_sources(chosen, run.pool, folder))
        run.stopwatch.measure()  # what came before is not the loop's
        reinforce(run)
        weights = _weigh(run)
    workers, overlap = chosen.collector.num_workers, chosen.collector.overlap
    groups = count_rounds(chosen)
    row = {"collector": chosen.collector.pool._target_.rpartition(".")[2], "workers": workers}
    row |= {"overlap": overlap, **_summarise(run.folder, warmup, min(workers, groups)), **weights}
    notes = [tell_who_waits(row, groups)] if overlap else []
    return row | {"notes": [*notes, *filter(None, [describe_idle_workers(chosen)])]}


def _weigh(run: Run) -> dict[str, int]:
    """Bytes of an episode as a worker hands it over, and of the policy that it is sent with each round."""
    policy = copy_for_rollouts(*make_actors(run))
    (episodes,) = run.pool.run("train", policy, [0], explore=True)
    return {
        "episode_bytes": len(pickle.dumps(episodes)) // len(episodes),
        "policy_bytes": len(pickle.dumps(policy)),
    }


def _summarise(run_dir: Path, warmup: int, busy: int) -> dict[str, float]:
    """Means over the iterations after those that warm up, of `busy` workers at most at a time."""
    columns = {name: np.nan_to_num(column[warmup:]) for name, column in read_metrics(run_dir).items()}
    seconds = {part: columns[f"time/{part}_s"] for part in ("rollouts", "updates", "other")}
    whole = float(sum(column.sum() for column in seconds.values()))
    counts = {
        part: float((columns[f"speed/{name}_per_s"] * seconds[part]).sum())
        for part, name in (("rollouts", "env_steps"), ("updates", "updates"))
    }
    spent = {part: float(column.sum()) for part, column in seconds.items()}
    iterations = len(seconds["other"])
    worked = float(columns["time/workers_s"].sum()) if busy else spent["rollouts"]
    return {
        "env_steps_per_second": counts["rollouts"] / spent["rollouts"],
        "updates_per_second": counts["updates"] / spent["updates"],
        "iteration_seconds": whole / iterations,
        "env_steps_per_second_of_both": counts["rollouts"] / whole,
        "learner_waits_seconds": spent["rollouts"] / iterations,
        "worker_waits_seconds": max(0.0, whole - worked / max(1, busy)) / iterations,
        "env_step_milliseconds": 1e3 * worked / counts["rollouts"],
        "update_milliseconds": 1e3 * spent["updates"] / counts["updates"],
    }


def _print_table(rows: dict[str, dict]) -> None:
    """A line a row, the seconds of an iteration also as a ratio to the first; then what it says of each."""
    widest = max(map(len, rows))
    first = next(iter(rows.values()))["iteration_seconds"]
    heads = [f"{head:>{width}s}" for head, (width, _, _) in _COLUMNS.items()]
    print("  ".join([" " * widest, *heads, f"{'speed':>6s}"]))
    for name, row in rows.items():
        cells = [f"{row[key]:{width}.{digits}f}" for width, key, digits in _COLUMNS.values()]
        print("  ".join([f"{name:{widest}s}", *cells, f"x {first / row['iteration_seconds']:4.2f}"]))
    sizes = (next(iter(rows.values()))[f"{what}_bytes"] / 1e3 for what in ("episode", "policy"))
    print("An episode has {:.0f} kB, and the policy of a round {:.0f} kB.".format(*sizes))
    for name, row in rows.items():
        for note in row["notes"]:
            print(f"{name}: {note}")
