"""Run directories as the recipes leave them, with success rates of one's choice."""

import json
from pathlib import Path
from typing import Any

import yaml

from torchgrasp.evaluation.comparison import GroupRow, compare_runs
from torchgrasp.evaluation.run_results import RunResult, read_result
from torchgrasp.evaluation.success import SuccessTable

CONFIG = {
    "objects": {"_target_": "torchgrasp.objects.ProceduralObjects", "split": "train", "num_objects": 160},
    "env": {"horizon": 30, "num_envs": 7, "target_motion": "static"},
    "evaluation": {"seed": 1000, "episodes": 10, "num_envs": 7, "split": "test", "num_objects": 80},
}


def success_table(successes: int, episodes: int = 10) -> dict:
    table = SuccessTable()
    for index in range(episodes):
        name = ("mug", "bowl")[index % 2]
        table.add(name, index < successes, cause=None if index < successes else "slipped")
    return table.summary()


def write_run(folder: Path, seed: int, successes: int, *, config: Any = None, **summary: Any) -> Path:
    """A finished run of 10 test episodes; `config` changes parts of its configuration."""
    folder.mkdir(parents=True)
    config = config or {}
    parts = {name: {**CONFIG.get(name, {}), **config.get(name, {})} for name in {**CONFIG, **config}}
    (folder / "config.yaml").write_text(yaml.safe_dump({"seed": seed, **parts}))
    counts = {"wall_seconds": 600.0, "env_steps": 33600, "gradient_steps": 5000}
    counts |= {"versions": {}, "hardware": {}}
    (folder / "summary.json").write_text(json.dumps({**success_table(successes), **counts, **summary}))
    return folder


def read_runs(folder: Path, successes: dict[int, int], **options: Any) -> list[RunResult]:
    """A run of ten episodes for each seed."""
    return [read_result(write_run(folder / str(seed), seed, n, **options)) for seed, n in successes.items()]


def compare_four_groups(folder: Path) -> list[GroupRow]:
    """Three seeds without, the same three with, two other seeds, and one alone."""
    groups = {
        "without": read_runs(folder / "a", {0: 3, 1: 4, 2: 5}, wall_seconds=600.0),
        "with": read_runs(folder / "b", {2: 8, 0: 5, 1: 8}, wall_seconds=1200.0),
        "other seeds": read_runs(folder / "c", {5: 6, 6: 8}),
        "alone": read_runs(folder / "d", {0: 10}),
    }
    return compare_runs(groups)
