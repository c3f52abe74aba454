import pytest

from tests import warm_python
from tests.configurations import compose_config
from tests.recipes.runner import command, environment, find_run


@pytest.fixture
def run_recipe(tmp_path):
    """Starts a recipe as a user would and returns (exit code, standard output, standard error)."""

    def run(name: str, *overrides: str, timeout: float = 240):
        given = command(name, tmp_path, *overrides)
        finished = warm_python.run(given, timeout=timeout, env=environment())
        return finished.returncode, finished.stdout, finished.stderr

    return run


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """The run directory of a short td3_bc run, and its summary; a test copies what it would change."""
    from recipes import td3_bc

    root = tmp_path_factory.mktemp("trained")
    given = [f"output_dir={root}", "experiment=smoke", "evaluation.baselines=[random]"]
    summary = td3_bc.train(compose_config(*given, "env.horizon=8", "total_env_steps=32"))
    return find_run(root, "td3_bc"), summary
