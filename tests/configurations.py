"""Configurations as a recipe's command line composes them."""

from pathlib import Path

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

ROOT = Path(__file__).parents[1]


def compose_config(*overrides: str, recipe: str = "td3_bc") -> DictConfig:
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        return compose(recipe, [*overrides])
