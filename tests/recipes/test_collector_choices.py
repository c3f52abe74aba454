"""Who collects changes nothing in training: one process, workers that are killed on the way, Ray."""

import os
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from tests import warm_python
from tests.recipes.runner import command, environment, find_run, read_results
from tests.warm_python import WarmProcess

OPTIONS = ("experiment=smoke", "evaluation.baselines=[]", "pretrain.steps=0", "evaluation.episodes=2")


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> list[dict[str, str]]:
    """Metrics of a run with overlap in one process."""
    root = tmp_path_factory.mktemp("alone")
    given = command("td3_bc", root, *OPTIONS, "collector=async", "collector.num_workers=0")
    done = warm_python.run(given, timeout=200, env=environment())
    assert done.returncode == 0, done.stderr
    return read_results(find_run(root, "td3_bc"))


@pytest.mark.slow
def test_a_worker_killed_while_training_changes_nothing(alone, tmp_path):
    process = WarmProcess(
        command("td3_bc", tmp_path, *OPTIONS, "collector=async", "collector.num_workers=1"),
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    killed = wait_for_worker(tmp_path, process)
    os.kill(killed, signal.SIGKILL)
    _, err = process.communicate(timeout=200)
    assert process.returncode == 0, err
    assert err.count(f"Worker 0 (process {killed}) was killed by SIGKILL") == err.count("was killed by") == 1
    assert read_results(find_run(tmp_path, "td3_bc")) == alone


def wait_for_worker(root: Path, process: WarmProcess) -> int:
    """The process id of the worker, once the first round has been learned from."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        if any(path.stat().st_size > 0 for path in root.glob("td3_bc/*/metrics.csv")):
            for server in psutil.Process(process.pid).children():
                if "forkserver" in " ".join(server.cmdline()):
                    return server.children()[0].pid
        time.sleep(0.02)
    raise AssertionError(f"no worker before the run ended with {process.poll()}")


@pytest.mark.slow
def test_training_on_ray_is_the_same(alone, tmp_path):
    workers = ["collector=ray", "collector.num_workers=1", "collector.overlap=true"]
    given = command("td3_bc", tmp_path, *OPTIONS, *workers)
    done = warm_python.run(given, timeout=200, env=environment())
    assert done.returncode == 0, done.stderr
    assert read_results(find_run(tmp_path, "td3_bc")) == alone
