"""A run's directory and configuration: made for a new run, taken up again by `resume`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from torchgrasp.config.exploration import check_exploration
from torchgrasp.config.overrides import given_values, merge, plain
from torchgrasp.config.part_kinds import check_references, check_strangers_parts
from torchgrasp.config.schema import Resumption
from torchgrasp.config.sweeps import note_run
from torchgrasp.config.training_checks import check_training
from torchgrasp.config.value_checks import check_section
from torchgrasp.data.files import read_sealed_text, seal_text, write_text_atomically
from torchgrasp.documents import parse_yaml
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import make_run_dir
from torchgrasp.runs.checkpoint import check_format, checkpoint_exists

# config.yaml is resolved, for readers; this one keeps its references, so that a change reaches all.
_UNRESOLVED = ".config_unresolved.yaml"
_REMEDY = "restore it from a copy, or begin a new run with init=<run>"


def training_config(cfg: DictConfig, recipe: str) -> DictConfig:
    """The checked configuration: with `resume` that of the run resumed, changed by what was given."""
    if (named := cfg.get("recipe")) != recipe:  # it may have been deleted
        raise ConfigError(f"This experiment is for the recipe {named}: run it by that, not by {recipe}.")
    if cfg.resume is not None:
        check_section("", {"resume": plain(cfg.resume), "trust": plain(cfg.trust)}, Resumption)
        folder = Path(str(cfg.resume))  # a name of digits is read as a number
        stored = _read(folder / _UNRESOLVED, f"resume={folder}", recipe, cfg.trust)
        if checkpoint_exists(folder):
            check_format(folder / "checkpoint")
        cfg = merge(stored, given_values(f"resume={folder}"), {"resume": str(folder)})
    check_training(cfg)
    check_exploration(cfg, "noise", f"the recipe {recipe}")
    return cfg


def open_run_dir(cfg: DictConfig, recipe: str) -> Path:
    """The directory of the run that `resume` names, or a new one with the configuration in it."""
    if cfg.get("resume") is not None:
        note_run(Path(cfg.resume))
        return Path(cfg.resume)
    run_dir = make_run_dir(recipe, root=str(cfg.output_dir), files=_files(cfg))
    note_run(run_dir)
    return run_dir


def keep_configuration(cfg: DictConfig, folder: Path) -> None:
    """Have the directory of a run that was resumed tell what was given beside `resume`, too."""
    begun = cfg.copy()
    begun.resume = None
    for name, text in _files(cast(DictConfig, begun)).items():
        write_text_atomically(folder / name, text)


def _files(cfg: DictConfig) -> dict[str, str]:
    """The texts of a directory that tell its configuration, by name."""
    files = {"config.yaml": OmegaConf.to_yaml(cfg, resolve=True)}
    if "resume" in cfg:
        files[_UNRESOLVED] = seal_text(OmegaConf.to_yaml(cfg))
    return files


def _read(file: Path, option: str, recipe: str, trust: Iterable[str]) -> DictConfig:
    """The configuration in a run directory that anyone may have made: nothing of it is called yet."""
    if not file.is_file():
        raise CheckpointError(f"{option} is no run directory of {recipe} ({file.name} is not in it).")
    content = parse_yaml(read_sealed_text(file, _REMEDY), file, _REMEDY)
    kind = content.get("recipe") if isinstance(content, dict) else None
    if kind != recipe:
        raise CheckpointError(
            f"{option} is no run directory of {recipe}: {file} is of {kind or 'another kind'}."
        )
    check_references(content, str(file))
    stored: Any = OmegaConf.create(content)
    try:
        resolved: Any = OmegaConf.to_container(stored, resolve=True)
    except OmegaConfBaseException as error:
        raise CheckpointError(f"{file} cannot be used ({str(error).splitlines()[0]}): {_REMEDY}.") from error
    check_strangers_parts(resolved, str(file), trust)
    return stored
