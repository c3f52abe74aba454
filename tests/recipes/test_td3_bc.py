"""recipes/td3_bc.py end to end: what it writes, and that a run killed on the way ends like any other."""

import functools
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from recipes import td3_bc
from tests import warm_python
from tests.configurations import change_run
from tests.recipes.runner import (
    command,
    environment,
    find_processes,
    find_run,
    read_metrics,
    read_results,
)
from tests.warm_python import WarmProcess
from torchgrasp.config import Run, make_actor_critic
from torchgrasp.errors import CheckpointError, ConfigError

slow = functools.partial(pytest.param, marks=pytest.mark.slow)
REQUIRED = {
    *("success_rate", "success_ci95", "episodes", "objects", "wall_seconds", "env_steps", "gradient_steps"),
    *("versions", "hardware"),
}


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("whole")
    done = warm_python.run(command("td3_bc", root, "experiment=smoke"), timeout=300, env=environment())
    assert done.returncode == 0, done.stderr
    return find_run(root, "td3_bc")


def test_a_run_leaves_its_record(finished_run):
    summary = json.loads((finished_run / "summary.json").read_text())
    assert summary.keys() >= REQUIRED
    assert set(summary["comparison"]) == {"policy", "policy after imitation alone", "expert", "random"}
    assert summary["episodes"] == 4 and summary["env_steps"] >= 48 and summary["gradient_steps"] == 6 + 3 * 4
    assert sum(each["episodes"] for each in summary["objects"].values()) == 4
    for name in ("config.yaml", "weights.safetensors", "checkpoint", "demonstrations", "report.html"):
        assert (finished_run / name).exists()
    assert not (finished_run / "tensorboard").exists()
    rows = read_metrics(finished_run)
    assert {
        "critic/loss_qvalue",
        "actor/loss_actor_bc",
        "actor/loss_actor_ddpg",
        "train/success_rate",
    } <= set(rows[0])


def test_a_page_shows_curves_baselines_and_failures(finished_run):
    text = (finished_run / "report.html").read_text()
    assert "<th>policy after imitation alone</th>" in text and "<th>random</th>" in text
    assert 'alt="critic/td_error"' in text and "<td>replay.online_fraction</td>" in text
    # Six steps are too few to grasp: the four episodes failed.
    assert text.count("data:image/png") == 4


def test_a_run_tells_where_its_time_goes_and_its_memory(finished_run):
    summary = json.loads((finished_run / "summary.json").read_text())
    online = [row for row in read_metrics(finished_run) if row["time/rollouts_s"]]
    steps = sum(float(row["speed/env_steps_per_s"]) * float(row["time/rollouts_s"]) for row in online)
    assert steps == pytest.approx(summary["env_steps"])
    updates = sum(float(row["speed/updates_per_s"]) * float(row["time/updates_s"]) for row in online)
    assert updates == pytest.approx(3 * len(online))
    seconds = [
        float(row[f"time/{name}_s"] or 0) for row in online for name in ("rollouts", "updates", "other")
    ]
    assert 0 < sum(seconds) < summary["wall_seconds"]
    held = [float(row["memory/process_mb"]) for row in read_metrics(finished_run) if row["memory/process_mb"]]
    assert held and all(50 < megabytes < 10_000 for megabytes in held)


@pytest.mark.parametrize(
    ("kill_at", "overrides"), [slow(0, []), (8, []), slow(15, ["collector.num_workers=1"])]
)
def test_killed_and_resumed_equals_never_killed(finished_run, tmp_path, kill_at, overrides):
    """Killed at the first checkpoint (0, while it imitates) or at a gradient step; also with a worker."""
    run_dir = kill_and_resume(tmp_path, kill_at, "experiment=smoke", *overrides)
    assert read_results(run_dir) == read_results(finished_run)
    ours, theirs = (json.loads((each / "summary.json").read_text()) for each in (run_dir, finished_run))
    assert ours["comparison"] == theirs["comparison"]
    weights = [(each / "weights.safetensors").read_bytes() for each in (run_dir, finished_run)]
    # The header tells the output directory, which differs; the tensors behind it do not.
    assert len(weights[0]) > 1000 and weights[0][-100_000:] == weights[1][-100_000:]


def kill_and_resume(root: Path, kill_at: int, *overrides: str) -> Path:
    """The directory of a run that was killed at a step, see `_wait_for_step`, and resumed to its end."""
    process = WarmProcess(
        command("td3_bc", root, *overrides),
        env=environment(),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    run_dir = _wait_for_step(root, kill_at, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not (run_dir / "summary.json").exists()
    done = warm_python.run(command("td3_bc", root, f"resume={run_dir}"), timeout=300, env=environment())
    assert done.returncode == 0, done.stderr
    return run_dir


def _wait_for_step(root: Path, step: int, process: WarmProcess | subprocess.Popen) -> Path:
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline and process.poll() is None:
        for run_dir in root.glob("td3_bc/*"):
            if step == 0 and (run_dir / "checkpoint").exists():
                return run_dir
            rows = read_metrics(run_dir) if step and (run_dir / "metrics.csv").exists() else []
            if any(int(row["step"]) >= step for row in rows if row["step"]):
                return run_dir
        time.sleep(0.02)
    raise AssertionError(f"no step {step} before the run ended with {process.poll()}")


@pytest.mark.slow
def test_a_killed_run_leaves_no_worker_behind(tmp_path):
    process = subprocess.Popen(
        command("td3_bc", tmp_path, "experiment=smoke", "collector.num_workers=1"),
        env={**environment(), "TORCHGRASP_TEST_MARK": str(tmp_path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _wait_for_step(tmp_path, 0, process)
    process.kill()
    process.wait()
    deadline = time.monotonic() + 20
    while find_processes(str(tmp_path)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not find_processes(str(tmp_path))


def test_demonstrations_of_another_configuration_are_refused(finished_run, composed):
    given = [f"demonstrations.path={finished_run / 'demonstrations'}", "experiment=smoke"]
    with pytest.raises(ConfigError, match="another transforms"):
        td3_bc.train(composed(*given, "transforms.sample.num_points=40"))


def test_resume_from_a_truncated_checkpoint_is_refused(finished_run, tmp_path, composed):
    broken = tmp_path / "broken"
    shutil.copytree(finished_run, broken)
    largest = max((broken / "checkpoint").rglob("*.safetensors"), key=lambda path: path.stat().st_size)
    largest.write_bytes(largest.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match=largest.name):
        td3_bc.train(composed(f"resume={broken}"))


@pytest.mark.slow
def test_the_actors_delay_counts_over_iterations_and_survives_a_resume(composed, tmp_path):
    """One critic update an iteration and a delay of 2: the actor learns in every second iteration."""
    given = ["experiment=smoke", "pretrain.steps=0", "online.updates=1", "online.policy_delay=2"]
    given += ["evaluation.baselines=[]", "evaluation.episodes=2", "total_env_steps=36"]
    td3_bc.train(composed(*given))
    run_dir = find_run(tmp_path, "td3_bc")
    change_run(run_dir, total_env_steps=72)
    td3_bc.train(composed(f"resume={run_dir}"))
    rows = [row for row in read_metrics(run_dir) if row["critic/loss_qvalue"]]
    assert [bool(row["actor/loss_actor_ddpg"]) for row in rows] == [False, True] * (len(rows) // 2)
    assert len(rows) == 6


def test_offline_nobody_acts_and_nobody_labels(composed):
    cfg = composed("experiment=smoke", "offline.updates=3", "collector.expert_start=null")
    assert td3_bc.make_actors(Run(cfg, make_actor_critic(cfg))) == []
