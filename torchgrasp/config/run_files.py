"""A run's directory and configuration: made for a new run, taken up again by `resume`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from torchgrasp.config.exploration import check_exploration
from torchgrasp.config.overrides import given_values, merge
from torchgrasp.config.sweeps import note_run
from torchgrasp.config.training_checks import check_training
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import make_run_dir
from torchgrasp.runs.checkpoint import check_format, checkpoint_exists

# config.yaml is resolved, for readers; this one keeps its references, so that a change reaches all.
_UNRESOLVED = ".config_unresolved.yaml"


def training_config(cfg: DictConfig, recipe: str) -> DictConfig:
    """The checked configuration: with `resume` that of the run resumed, changed by what was given."""
    if cfg.recipe != recipe:
        raise ConfigError(f"This experiment is for the recipe {cfg.recipe}: run it by that, not by {recipe}.")
    if cfg.resume is not None:
        stored = _read(Path(cfg.resume) / _UNRESOLVED, f"resume={cfg.resume}", recipe)
        if checkpoint_exists(cfg.resume):
            check_format(Path(cfg.resume) / "checkpoint")
        cfg = merge(stored, given_values(f"resume={cfg.resume}"), {"resume": cfg.resume})
    check_training(cfg)
    check_exploration(cfg, "noise", f"the recipe {recipe}")
    return cfg


def open_run_dir(cfg: DictConfig, recipe: str) -> Path:
    """The directory of the run that `resume` names, or a new one with the configuration in it."""
    if cfg.get("resume") is not None:
        note_run(Path(cfg.resume))
        return Path(cfg.resume)
    files = {"config.yaml": OmegaConf.to_yaml(cfg, resolve=True), _UNRESOLVED: OmegaConf.to_yaml(cfg)}
    run_dir = make_run_dir(recipe, root=cfg.output_dir, files=files)
    note_run(run_dir)
    return run_dir


def _read(file: Path, option: str, recipe: str) -> DictConfig:
    if not file.is_file():
        raise CheckpointError(f"{option} is no run directory of {recipe} ({file.name} is not in it).")
    try:
        stored: Any = OmegaConf.load(file)
    except (yaml.YAMLError, OmegaConfBaseException, OSError) as error:
        raise CheckpointError(f"{file} cannot be read ({error}): restore it from a copy.") from error
    kind = stored.get("recipe") if isinstance(stored, DictConfig) else None
    if kind != recipe:
        raise CheckpointError(
            f"{option} is no run directory of {recipe}: {file} is of {kind or 'another kind'}."
        )
    return stored
