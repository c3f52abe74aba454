import subprocess
import sys

import pytest
from hydra import compose, initialize_config_dir
from runner import ROOT, command, environment

sys.path.insert(0, str(ROOT / "recipes"))
sys.path.insert(0, str(ROOT / "tests" / "objects"))  # acronym_files


@pytest.fixture
def composed(tmp_path):
    """Composes a recipe's configuration with overrides, its output below tmp_path."""

    def compose_config(*overrides: str, recipe: str = "td3_bc"):
        with initialize_config_dir(str(ROOT / "conf"), version_base=None):
            return compose(recipe, [f"output_dir={tmp_path}", *overrides])

    return compose_config


@pytest.fixture
def run_recipe(tmp_path):
    """Starts a recipe as a user would and returns (exit code, standard output, standard error)."""

    def run(name: str, *overrides: str, timeout: float = 240):
        finished = subprocess.run(
            command(name, tmp_path, *overrides),
            capture_output=True,
            text=True,
            timeout=timeout,
            env=environment(),
        )
        return finished.returncode, finished.stdout, finished.stderr

    return run
