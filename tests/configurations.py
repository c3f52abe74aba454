"""Configurations as a recipe's command line composes them."""

from pathlib import Path

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from torchgrasp.data.files import seal_text

ROOT = Path(__file__).parents[1]


def compose_config(*overrides: str, recipe: str = "td3_bc") -> DictConfig:
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        return compose(recipe, [*overrides])


def change_run(run_dir: Path, **values) -> None:
    """Write other values into the configuration that a resumed run begins with, by their dotted names."""
    file = run_dir / ".config_unresolved.yaml"
    stored = OmegaConf.load(file)
    for name, value in values.items():
        OmegaConf.update(stored, name, value)
    file.write_text(seal_text(OmegaConf.to_yaml(stored)))
