"""The main job end to end: what it writes, and that a run killed on the way ends like one that was not."""

import csv
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from runner import command, environment

REQUIRED = {
    *("success_rate", "success_ci95", "episodes", "objects", "wall_seconds", "env_steps", "gradient_steps"),
    *("versions", "hardware"),
}

_CLOCKED = ("time/", "speed/", "memory/")


def read_metrics(run_dir: Path) -> list[dict[str, str]]:
    with (run_dir / "metrics.csv").open() as stream:
        return list(csv.DictReader(stream))


def read_results(run_dir: Path) -> list[dict[str, str]]:
    """The metrics that do not depend on how fast the machine is, or when it was interrupted."""
    return [{n: v for n, v in row.items() if not n.startswith(_CLOCKED)} for row in read_metrics(run_dir)]


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("whole")
    subprocess.run(
        command("td3_bc", root, "experiment=smoke"),
        check=True,
        timeout=300,
        env=environment(),
        capture_output=True,
    )
    (run_dir,) = (root / "td3_bc").iterdir()
    return run_dir


def test_a_run_leaves_its_record(finished_run):
    summary = json.loads((finished_run / "summary.json").read_text())
    assert summary.keys() >= REQUIRED
    assert set(summary["comparison"]) == {"policy", "policy after imitation alone", "expert", "random"}
    assert summary["episodes"] == 4 and summary["env_steps"] >= 48 and summary["gradient_steps"] == 6 + 3 * 4
    assert sum(each["episodes"] for each in summary["objects"].values()) == 4
    for name in ("config.yaml", "weights.safetensors", "checkpoint", "tensorboard", "demonstrations"):
        assert (finished_run / name).exists()
    rows = read_metrics(finished_run)
    assert {
        "critic/loss_qvalue",
        "actor/loss_actor_bc",
        "actor/loss_actor_ddpg",
        "train/success_rate",
    } <= set(rows[0])


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


@pytest.mark.parametrize(("kill_at", "overrides"), [(0, []), (8, []), (15, ["collector.num_workers=1"])])
def test_killed_and_resumed_equals_never_killed(finished_run, tmp_path, kill_at, overrides):
    """Killed at the first checkpoint (0, while it imitates) or at a gradient step; also with a worker."""
    process = subprocess.Popen(
        command("td3_bc", tmp_path, "experiment=smoke", *overrides),
        env=environment(),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    run_dir = _wait_for_step(tmp_path, kill_at, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not (run_dir / "summary.json").exists()
    subprocess.run(
        command("td3_bc", tmp_path, f"resume={run_dir}"),
        check=True,
        timeout=300,
        env=environment(),
        capture_output=True,
    )
    assert read_results(run_dir) == read_results(finished_run)
    ours, theirs = (json.loads((each / "summary.json").read_text()) for each in (run_dir, finished_run))
    assert ours["comparison"] == theirs["comparison"]
    weights = [(each / "weights.safetensors").read_bytes() for each in (run_dir, finished_run)]
    # The header tells the output directory, which differs; the tensors behind it do not.
    assert len(weights[0]) > 1000 and weights[0][-100_000:] == weights[1][-100_000:]


def _wait_for_step(root: Path, step: int, process: subprocess.Popen) -> Path:
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
    while _marked(str(tmp_path)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _marked(str(tmp_path))


def _marked(mark: str) -> list[str]:
    """Processes that carry the mark in their environment."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"TORCHGRASP_TEST_MARK={mark}".encode() in entry.read_bytes():
                found.append(entry.parent.name)
        except OSError:
            continue
    return found


def test_demonstrations_of_another_configuration_are_refused(finished_run, run_recipe):
    given = [f"demonstrations.path={finished_run / 'demonstrations'}", "experiment=smoke"]
    code, _, err = run_recipe("td3_bc", *given, "transforms.sample.num_points=40")
    assert code == 1 and "transforms" in err and "Traceback" not in err
    code, _, err = run_recipe("collect", *given, "seed=1")
    assert code == 1 and "seed" in err and "Traceback" not in err


def test_a_trained_policy_brings_its_network_and_transforms_along(finished_run, run_recipe):
    given = [f"policy={finished_run}", "episodes=2", "collector.num_workers=0", "objects.num_objects=2"]
    code, out, err = run_recipe("evaluate", *given, "objects.num_grasps=100")
    assert code == 0, err
    assert "2 scenes of the test split" in out
    code, _, err = run_recipe("evaluate", *given, "transforms=single_view")
    assert code == 1 and "transforms" in err and "Traceback" not in err


def test_resume_from_a_truncated_checkpoint_is_refused(finished_run, tmp_path, run_recipe):
    broken = tmp_path / "broken"
    shutil.copytree(finished_run, broken)
    largest = max((broken / "checkpoint").rglob("*.safetensors"), key=lambda path: path.stat().st_size)
    largest.write_bytes(largest.read_bytes()[:-100])
    code, _, err = run_recipe("td3_bc", f"resume={broken}")
    assert code == 1 and err.count("error:") == 1 and "Traceback" not in err and largest.name in err
