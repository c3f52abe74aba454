"""Throughput of the online phase of training: rollouts and updates, by collector.num_workers and overlap."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import collect
import common
import numpy as np
import td3_bc
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from learner import Learner
from omegaconf import DictConfig

from torchgrasp.errors import ConfigError, check_whole
from torchgrasp.evaluation.learning_curves import read_metrics
from torchgrasp.runs.metrics import MetricsLogger

_CONF = Path(__file__).resolve().parents[1] / "conf"
_HEAD: tuple[str, ...] = (
    "workers",
    "env steps/s",
    "",
    "updates/s",
    "",
    "iteration, s",
    "",
    "both, env steps/s",
)


def benchmark_training(cfg: DictConfig) -> dict[str, dict[str, float]]:
    """A row for each number of workers, and for each that can overlap collecting and learning one more.

    The loop is td3_bc's own, and so are the figures: what it writes into metrics.csv.
    """
    check_workers(cfg)
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, overrides) in enumerate(_variants(cfg)):
            rows[name] = _measure(_compose(cfg, *overrides), cfg, Path(folder), number)
            print(f"{name}: {rows[name]['iteration_seconds']:.1f} s an iteration", flush=True)
    _print_table(rows)
    return rows


def check_workers(cfg: DictConfig) -> None:
    """Refuse an empty list and numbers of workers that there cannot be."""
    if not cfg.training.workers:
        raise ConfigError("training.workers=[]: give at least one number of workers, such as [0,1,2].")
    for workers in cfg.training.workers:
        check_whole("training.workers", workers, 0)


def _variants(cfg: DictConfig) -> Iterator[tuple[str, list[str]]]:
    """Names and overrides; overlap where the configured collector offers it and there are workers."""
    can_overlap = "overlap" in _compose(cfg).collector
    for workers in cfg.training.workers:
        given = [f"collector.num_workers={workers}"]
        yield str(workers), [*given, *(["collector.overlap=false"] if can_overlap else [])]
        if can_overlap and workers:
            yield f"{workers}, overlapping", [*given, "collector.overlap=true"]


def _compose(cfg: DictConfig, *overrides: str) -> DictConfig:
    """The configuration of td3_bc.py, long enough for the iterations and without checkpoints between."""
    begun = GlobalHydra.instance().is_initialized()  # by hydra.main
    with contextlib.nullcontext() if begun else initialize_config_dir(str(_CONF), version_base=None):
        chosen = compose("td3_bc", [*cfg.training.overrides, *overrides])
    rounds = -(-chosen.collector.episodes // chosen.env.num_envs)
    steps = rounds * chosen.env.num_envs * chosen.env.horizon
    chosen.total_env_steps = (cfg.training.warmup + cfg.training.iterations) * steps
    chosen.checkpoint.iterations = 10**9
    chosen.seed, chosen.device = cfg.seed, cfg.device
    return chosen


def _measure(chosen: DictConfig, cfg: DictConfig, folder: Path, number: int) -> dict[str, float]:
    run_dir = folder / str(number)
    learner = Learner(chosen, common.observed_shapes(chosen))
    logger = MetricsLogger(run_dir, tensorboard=False)
    with common.make_pool(chosen) as pool, contextlib.closing(logger):
        common.prepare_objects(chosen, "train")
        sources = collect.demonstrations(chosen, pool, folder)  # the first row's serve all
        learner.experience.make_buffer(sources)
        learner.experience.load_demonstrations()
        td3_bc.reinforce(chosen, learner, logger, pool, run_dir)
    return _summarise(run_dir, cfg.training.warmup)


def _summarise(run_dir: Path, warmup: int) -> dict[str, float]:
    columns = {name: np.nan_to_num(column[warmup:]) for name, column in read_metrics(run_dir).items()}
    seconds = {part: columns[f"time/{part}_s"] for part in ("rollouts", "updates", "other")}
    whole = float(sum(column.sum() for column in seconds.values()))
    counts = {
        part: float((columns[f"speed/{name}_per_s"] * seconds[part]).sum())
        for part, name in (("rollouts", "env_steps"), ("updates", "updates"))
    }
    return {
        "env_steps_per_second": counts["rollouts"] / float(seconds["rollouts"].sum()),
        "updates_per_second": counts["updates"] / float(seconds["updates"].sum()),
        "iteration_seconds": whole / len(seconds["updates"]),
        "env_steps_per_second_of_both": counts["rollouts"] / whole,
    }


def _print_table(rows: dict[str, dict[str, float]]) -> None:
    """Figures beside their ratios to the first row; of overlapping rollouts only the wait would be timed."""
    base = next(iter(rows.values()))
    lines: list[tuple[str, ...]] = [_HEAD]
    for name, row in rows.items():
        cells = [name]
        for key, digits in (("env_steps_per_second", 0), ("updates_per_second", 1), ("iteration_seconds", 2)):
            ratio = row[key] / base[key] if key != "iteration_seconds" else base[key] / row[key]
            alone = key != "env_steps_per_second" or "overlapping" not in name
            cells += [f"{row[key]:.{digits}f}", f"x {ratio:.2f}"] if alone else ["-", ""]
        lines.append((*cells, f"{row['env_steps_per_second_of_both']:.0f}"))
    for line in lines:
        print(
            "  ".join(
                f"{cell:>{width}s}" for cell, width in zip(line, (14, 11, 7, 9, 7, 12, 7, 17), strict=True)
            )
        )
