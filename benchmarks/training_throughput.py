"""suite=training: rollouts and updates of td3_bc's online phase, by collector.num_workers and overlap."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from composition import compose_config
from omegaconf import DictConfig

from torchgrasp.config import Run, gather_sources, make_actor_critic, training_config
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.learning_curves import read_metrics
from torchgrasp.recipes.td3_bc import reinforce  # pyright: ignore[reportMissingImports]  recipes/ as installed
from torchgrasp.runs import seed_everything

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
    if not cfg.training.workers:
        raise ConfigError("training.workers=[]: give at least one number of workers, such as [0,1,2].")
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, overrides in _list_variants(cfg):
            rows[name] = _measure(_compose(cfg, *overrides), cfg.training.warmup, Path(folder))
            print(f"{name}: {rows[name]['iteration_seconds']:.1f} s an iteration", flush=True)
    _print_table(rows)
    return rows


def _list_variants(cfg: DictConfig) -> Iterator[tuple[str, list[str]]]:
    """Names and overrides: every number of workers, and with any of them overlapping as well."""
    for workers in cfg.training.workers:
        given = [f"collector.num_workers={workers}"]
        yield str(workers), [*given, "collector.overlap=false"]
        if workers:
            yield f"{workers}, overlapping", [*given, "collector.overlap=true"]


def _compose(cfg: DictConfig, *overrides: str) -> DictConfig:
    """The configuration of td3_bc.py, long enough for the iterations and without checkpoints between."""
    chosen = compose_config("td3_bc", [*cfg.training.overrides, *overrides])
    rounds = -(-chosen.collector.episodes // chosen.env.num_envs)
    steps = rounds * chosen.env.num_envs * chosen.env.horizon
    chosen.total_env_steps = (cfg.training.warmup + cfg.training.iterations) * steps
    chosen.checkpoint.iterations = 10**9
    chosen.evaluation.num_objects = 1  # nothing is evaluated, but a run prepares these objects too
    chosen.seed, chosen.device = cfg.seed, cfg.device
    return training_config(chosen, "td3_bc")


def _measure(chosen: DictConfig, warmup: int, folder: Path) -> dict[str, float]:
    """One run of the online phase below `folder`, where all runs share their demonstrations."""
    chosen.output_dir = str(folder)
    seed_everything(chosen.seed)
    with Run(chosen, make_actor_critic(chosen)) as run:
        run.begin(gather_sources(chosen, run.pool, folder))
        run.stopwatch.measure()  # what came before is not the loop's
        reinforce(run)
    return _summarise(run.folder, warmup)


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
