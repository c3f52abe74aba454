"""Who collects changes nothing in training: one process, workers that are killed on the way, Ray."""

import csv
import os
import signal
import subprocess
import time
from pathlib import Path

import common
import pytest
from runner import ROOT, command, environment

from torchgrasp.rollouts.episode_pool import SerialPool
from torchgrasp.rollouts.process_pool import ProcessPool
from torchgrasp.rollouts.ray_pool import RayPool

CHOICES = sorted(path.stem for path in (ROOT / "conf" / "collector").glob("*.yaml"))
OPTIONS = ("experiment=smoke", "evaluation.baselines=[]", "pretrain.steps=0", "evaluation.episodes=2")


def read_metrics(root: Path) -> list[dict[str, str]]:
    (path,) = root.glob("td3_bc/*/metrics.csv")
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    clocks = ("time/", "speed/", "memory/")  # that no two runs share
    return [{name: value for name, value in row.items() if not name.startswith(clocks)} for row in rows]


@pytest.mark.parametrize("name", CHOICES)
def test_every_choice_makes_its_pool_in_every_recipe(composed, name):
    chosen = [f"collector={name}", f"collector.num_workers={0 if name == 'serial' else 2}"]
    cfg = composed("experiment=smoke", *chosen)
    evaluation = composed("policy=random", *chosen, recipe="evaluate")
    assert evaluation.collector.pool == cfg.collector.pool
    assert cfg.collector.overlap == (name == "async")
    with common.make_pool(cfg) as pool:
        kinds = {"serial": SerialPool, "pool": ProcessPool, "async": ProcessPool, "ray": RayPool}
        assert type(pool) is kinds[name]


def test_no_workers_is_this_process(composed):
    cfg = composed("experiment=smoke", "collector=async", "collector.num_workers=0")
    assert isinstance(common.make_pool(cfg), SerialPool)


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> list[dict[str, str]]:
    """Metrics of a run with overlap in one process."""
    root = tmp_path_factory.mktemp("alone")
    subprocess.run(
        command("td3_bc", root, *OPTIONS, "collector=async", "collector.num_workers=0"),
        check=True,
        timeout=200,
        env=environment(),
        capture_output=True,
    )
    return read_metrics(root)


def test_a_worker_killed_while_training_changes_nothing(alone, tmp_path):
    process = subprocess.Popen(
        command("td3_bc", tmp_path, *OPTIONS, "collector=async", "collector.num_workers=1"),
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    killed = wait_for_worker(tmp_path, process)
    os.kill(killed, signal.SIGKILL)
    _, err = process.communicate(timeout=200)
    assert process.returncode == 0, err
    assert err.count("takes its place") == 1 and f"Worker 0 (process {killed}) was killed by SIGKILL" in err
    assert read_metrics(tmp_path) == alone


def wait_for_worker(root: Path, process: subprocess.Popen) -> int:
    """The process id of the worker, once the first round has been learned from."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        if any(path.stat().st_size > 0 for path in root.glob("td3_bc/*/metrics.csv")):
            children = [
                child
                for task in Path(f"/proc/{process.pid}/task").iterdir()
                for child in (task / "children").read_text().split()
            ]
            for child in children:
                if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                    return int(child)
        time.sleep(0.02)
    raise AssertionError(f"no worker before the run ended with {process.poll()}")


def test_training_on_ray_is_the_same(alone, tmp_path):
    done = subprocess.run(
        command(
            "td3_bc", tmp_path, *OPTIONS, "collector=ray", "collector.num_workers=2", "collector.overlap=true"
        ),
        timeout=200,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert read_metrics(tmp_path) == alone
