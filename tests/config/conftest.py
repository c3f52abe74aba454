import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

from tests.configurations import ROOT, compose_config
from torchgrasp.config import collect, make_pool
from torchgrasp.config.networks import make_networks
from torchgrasp.data import open_demonstrations
from torchgrasp.runs import save_weights


@pytest.fixture
def on_command_line(tmp_path):
    """Composes a configuration, and lets Hydra know of its overrides as when a recipe is started."""

    def compose_started(*overrides: str, recipe: str = "td3_bc"):
        given = [f"output_dir={tmp_path}", *overrides]
        with initialize_config_dir(str(ROOT / "conf"), version_base=None):
            HydraConfig.instance().set_config(compose(recipe, given, return_hydra_config=True))
        return compose_config(*given, recipe=recipe)

    yield compose_started
    HydraConfig.instance().cfg = None


@pytest.fixture
def untrained(tmp_path):
    """Saves the weights of untrained networks of a smoke run with overrides; returns their file."""

    def save(*overrides: str, name: str = "trained", recipe: str = "td3_bc"):
        cfg = compose_config("experiment=smoke", *overrides, recipe=recipe)
        path = tmp_path / name / "weights.safetensors"
        networks = make_networks(cfg.model, critic=recipe != "bc")
        save_weights(path, networks, OmegaConf.to_container(cfg, resolve=True))
        return path

    return save


@pytest.fixture(scope="session")
def demonstrations(tmp_path_factory):
    """A folder of perturbed demonstrations of a smoke run; a test copies what it would change."""
    path = tmp_path_factory.mktemp("demonstrations") / "demos"
    cfg = compose_config("experiment=smoke")
    with make_pool(cfg) as pool:
        collect(cfg, pool, path)
    return path


@pytest.fixture
def collected(tmp_path):
    """Collects with overrides into a folder of that name, and opens it."""

    def run(*overrides: str, name: str = "demos"):
        cfg = compose_config("experiment=smoke", *overrides)
        with make_pool(cfg) as pool:
            collect(cfg, pool, tmp_path / name)
        return open_demonstrations(tmp_path / name)

    return run
