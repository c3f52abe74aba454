"""Run directories as the recipes leave them, with success rates of one's choice."""

import json
from pathlib import Path
from typing import Any

import yaml

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
    parts = {name: {**values, **(config or {}).get(name, {})} for name, values in CONFIG.items()}
    (folder / "config.yaml").write_text(yaml.safe_dump({"seed": seed, **parts}))
    counts = {"wall_seconds": 600.0, "env_steps": 33600, "gradient_steps": 5000}
    (folder / "summary.json").write_text(json.dumps({**success_table(successes), **counts, **summary}))
    return folder
