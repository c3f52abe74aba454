"""The report of a configured run: which options stand at its head, and where its scenes come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from torchgrasp.report.run_page import Picture, write_report

# What stands at the head of a report, where a recipe has it.
_HIGHLIGHTS = (
    *("seed", "objects._target_", "objects.num_objects", "evaluation.num_objects", "camera._target_"),
    "engine._target_",
    *("env.horizon", "env.target_motion", "evaluation.target_motion", "expert._target_"),
    *("model.encoder._target_", "num_points", "pretrain.steps", "total_env_steps"),
    *("loss.bc_weight", "replay.online_fraction", "init"),
)


def describe_scenes(cfg: DictConfig) -> str:
    """Where the objects of the evaluation come from, in words."""
    if cfg.objects.get("split") is None:
        return "the object set as a whole (it has no splits)"
    return f"the {cfg.evaluation.split} split"


def write_page(
    cfg: DictConfig, run_dir: Path, summary: Mapping[str, Any], pictures: Mapping[str, Sequence[Picture]]
) -> None:
    """report.html of a run, headed by its recipe's name and its most telling options."""
    chosen = {_readable(name): OmegaConf.select(cfg, name) for name in _HIGHLIGHTS}
    if "total_env_steps" not in cfg:  # nothing was trained on
        chosen.pop("objects.num_objects")
    if cfg.get("recipe") == "hindsight":  # which imitates nothing first
        chosen.pop("pretrain.steps")
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    write_report(
        run_dir,
        summary,
        title=f"{run_dir.resolve().parent.name} {run_dir.name}",
        highlights={name: _readable(value) for name, value in chosen.items() if value is not None},
        config=config,
        pictures=pictures,
    )


def _readable(value: Any) -> str:
    """A class by its own name, an option that names a class by what the class is for."""
    text = str(value).removesuffix("._target_")
    return text.rsplit(".", 1)[-1] if text.startswith("torchgrasp.") else text
