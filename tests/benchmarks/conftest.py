import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir

from tests import warm_python

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"

sys.path.insert(0, str(BENCHMARKS))


@pytest.fixture
def composed(tmp_path):
    """Composes the benchmarks' configuration with overrides, its output below tmp_path."""

    def compose_benchmark(*overrides: str):
        with initialize_config_dir(str(BENCHMARKS), version_base=None):
            return compose("benchmark", [f"output_dir={tmp_path}", *overrides])

    return compose_benchmark


@pytest.fixture
def run_benchmark(tmp_path):
    """Starts benchmark.py in a folder of its own and returns (exit code, standard output, standard error)."""

    def run(*overrides: str):
        command = [sys.executable, str(BENCHMARKS / "benchmark.py"), f"output_dir={tmp_path}", *overrides]
        done = warm_python.run(command, timeout=240, cwd=tmp_path)
        return done.returncode, done.stdout, done.stderr

    return run
