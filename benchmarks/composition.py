"""Configurations of conf/ beside the one that a benchmark was started with."""

from __future__ import annotations

from collections.abc import Sequence

from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig


def compose_config(name: str, overrides: Sequence[str] = ()) -> DictConfig:
    """conf/<name>.yaml with its defaults and the overrides, as a recipe would get it."""
    # Hydra allows one search path at a time, and hydra.main's begins in this folder.
    at_work = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_module("torchgrasp.conf", version_base=None):
            return compose(name, list(overrides))
    finally:
        GlobalHydra.instance().hydra = at_work
