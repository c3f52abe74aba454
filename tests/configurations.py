"""Configurations as a recipe's command line composes them."""

import functools
import os
from copy import deepcopy
from pathlib import Path
from typing import Any
from unittest import mock

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from torchgrasp.data.files import seal_text

ROOT = Path(__file__).parents[1]
_LOAD = OmegaConf.load


def compose_config(*overrides: str, recipe: str = "td3_bc") -> DictConfig:
    with _parsed_once(), initialize_config_dir(str(ROOT / "conf"), version_base=None):
        return compose(recipe, [*overrides])


def _parsed_once() -> Any:
    """Files of conf/ are parsed once a process: some 25 stand in a configuration, and most are in each."""
    return mock.patch.object(
        OmegaConf,
        "load",
        staticmethod(lambda file: deepcopy(_load(file.name, os.fstat(file.fileno()).st_mtime_ns))),
    )


@functools.cache
def _load(path: str, _changed: int) -> Any:
    with open(path, encoding="utf-8") as file:
        return _LOAD(file)


def change_run(run_dir: Path, **values) -> None:
    """Write other values into the configuration that a resumed run begins with, by their dotted names."""
    file = run_dir / ".config_unresolved.yaml"
    stored = OmegaConf.load(file)
    for name, value in values.items():
        OmegaConf.update(stored, name, value)
    file.write_text(seal_text(OmegaConf.to_yaml(stored)))
