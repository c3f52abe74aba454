"""Ctrl-C and SIGTERM in recipes: saved, and told in one line how to go on, as if nothing had been."""

import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest
import torch

from recipes import collect, evaluate, td3_bc
from tests.recipes.runner import command, environment, find_run, read_results
from tests.warm_python import WarmProcess
from torchgrasp.config import Run, gather_sources, make_actor_critic, training_config
from torchgrasp.errors import StorageError
from torchgrasp.interruption import Interrupted
from torchgrasp.runs import load_weights, seed_everything
from torchgrasp.runs.sweep_record import read_sweep

SMOKE = ("experiment=smoke", "evaluation.baselines=[]", "evaluation.episodes=2", "env.horizon=4")
SMOKE += ("total_env_steps=24", "checkpoint.iterations=100", "checkpoint.steps=100")


def train(cfg, interrupt_at: int | None = None) -> Path:
    """What the recipe does before it concludes; a signal comes while the batch of that number is drawn."""
    cfg = training_config(cfg, "td3_bc")
    seed_everything(cfg.seed)
    with Run(cfg, make_actor_critic(cfg)) as run:
        run.begin(gather_sources(cfg, run.pool, run.folder))
        draw, drawn = run.experience.sample, []

        def sample(batch_size: int | None = None):
            drawn.append(batch_size)
            if len(drawn) == interrupt_at:
                os.kill(os.getpid(), signal.SIGTERM)
            return draw(batch_size)

        run.experience.sample = sample
        td3_bc.pretrain(run)
        td3_bc.reinforce(run)
    return run.folder


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    from tests.configurations import compose_config

    return train(compose_config(f"output_dir={tmp_path_factory.mktemp('whole')}", *SMOKE))


@pytest.mark.slow
@pytest.mark.parametrize("update", [4, 8, 12])
def test_interrupted_in_an_update_and_resumed_equals_never_interrupted(
    composed, tmp_path, uninterrupted, update
):
    """Six updates of imitation, then three an iteration; no checkpoint but that of the interruption."""
    with pytest.raises(Interrupted) as interruption:
        train(composed(*SMOKE), interrupt_at=update)
    folder = find_run(tmp_path, "td3_bc")
    assert interruption.value.__notes__ == [f"The run goes on with resume={folder}"]
    assert train(composed(f"resume={folder}")) == folder
    assert read_results(folder) == read_results(uninterrupted)
    ours, theirs = (load_weights(each / "weights.safetensors")[0] for each in (folder, uninterrupted))
    assert all(torch.equal(value, theirs[name][key]) for name in ours for key, value in ours[name].items())


def test_training_in_another_thread_than_the_main_one(composed, tmp_path):
    done: list = []
    cfg = composed(*SMOKE, "total_env_steps=0")
    thread = threading.Thread(target=lambda: done.append(train(cfg)))
    thread.start()
    thread.join()
    assert done == [find_run(tmp_path, "td3_bc")]


def start(name: str, output_dir: Path, *overrides: str, **options) -> WarmProcess:
    """A recipe in a session of its own, in which ctrl-C is not ignored, as in a terminal."""
    return WarmProcess(
        command(name, output_dir, *overrides),
        env=environment(),
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        **options,
    )


def wait_for(condition, process: WarmProcess) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert process.poll() is None and time.monotonic() < deadline, process.stdout
        time.sleep(0.02)


def end(process: WarmProcess, number: int) -> str:
    """What is printed in all, once the process and all that hold its output have ended; as by a terminal."""
    os.killpg(process.pid, number)
    told, _ = process.communicate(timeout=60)
    assert "Traceback" not in told and "leaked" not in told, told
    return told


@pytest.mark.slow
def test_a_run_with_workers_is_saved_and_says_how_it_goes_on(tmp_path):
    given = ["total_env_steps=100000", "collector.num_workers=1", "collector.overlap=true"]
    process = start("td3_bc", tmp_path, *SMOKE, *given)
    wait_for(lambda: any("train/success_rate" in path.read_text() for path in metrics_of(tmp_path)), process)
    told = end(process, signal.SIGTERM)
    folder = find_run(tmp_path, "td3_bc")
    assert process.returncode == 143, told
    last = f"interrupted by SIGTERM. The run goes on with resume={folder}"
    assert told.splitlines()[-1] == last
    assert (folder / "checkpoint" / "manifest.json").exists()


def metrics_of(root: Path) -> list[Path]:
    return list(root.glob("td3_bc/*/metrics.csv"))


@pytest.mark.slow
def test_a_collection_says_how_it_goes_on(tmp_path):
    path = tmp_path / "demos"
    given = ["experiment=smoke", "demonstrations.steps=100000", f"demonstrations.path={path}"]
    process = start("collect", tmp_path, *given, "collector.num_workers=1")
    wait_for((path / "shard_00000").exists, process)
    refused = start("collect", tmp_path, *given)
    told, _ = refused.communicate(timeout=60)
    assert refused.returncode == 1 and told.startswith(f"error: {path} is being written by another process")
    assert told.count("\n") == 1
    told = end(process, signal.SIGTERM)
    assert process.returncode == 143
    last = f"interrupted by SIGTERM. The same command goes on with the whole shards in {path}."
    assert told.splitlines()[-1] == last


def test_another_recipe_ends_with_one_line(tmp_path):
    process = start("pendulum", tmp_path)
    assert process.stdout is not None and process.stdout.readline().startswith("seed")
    assert end(process, signal.SIGINT) == "interrupted by SIGINT\n"
    assert process.returncode == 130


@pytest.mark.slow
def test_the_jobs_of_a_sweep_end_in_good_order_and_no_further_one_begins(tmp_path):
    launcher = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    given = [*SMOKE, "total_env_steps=100000", *launcher, "seed=0,1,2", "-m"]
    process = start("td3_bc", tmp_path, *given)
    wait_for(lambda: sum(path.stat().st_size > 0 for path in metrics_of(tmp_path)) == 2, process)
    os.kill(process.pid, signal.SIGTERM)  # as by a scheduler, which may tell the jobs as well
    told = end(process, signal.SIGTERM)
    assert process.returncode == 143, told
    assert "0 of 3 jobs finished" in told and told.count(": interrupted by SIGTERM") == 3
    (sweep,) = tmp_path.glob("sweeps/*")
    runs = [job.run_dir for job in read_sweep(sweep)]
    assert [run for run in runs if run is None] == [None]
    for run in runs:
        assert run is None or ((run / "checkpoint").exists() and f"(go on with resume={run})" in told)


def test_one_process_at_a_time_trains_in_a_directory(composed):
    cfg = composed(*SMOKE, "total_env_steps=0")
    with Run(cfg, make_actor_critic(cfg)) as run:
        told = f"^{run.folder} is being written by another process: wait until that ends"
        with pytest.raises(StorageError, match=told):
            td3_bc.train(composed(f"resume={run.folder}"))


@pytest.mark.parametrize(
    ("recipe", "name", "given"),
    [
        (td3_bc.train, "td3_bc", "experiment=smoke"),
        (collect.run, "td3_bc", "experiment=smoke"),
        (evaluate.evaluate, "evaluate", "policy=random"),
    ],
    ids=["td3_bc", "collect", "evaluate"],
)
def test_an_output_directory_that_cannot_be_is_found_before_objects_are_prepared(
    composed, tmp_path, monkeypatch, recipe, name, given
):
    monkeypatch.setenv("TORCHGRASP_CACHE", str(tmp_path / "cache"))
    with pytest.raises(StorageError, match=r"^/dev/null/x.* cannot be written \(Not a directory\)"):
        recipe(composed(given, "output_dir=/dev/null/x", recipe=name))
    assert not (tmp_path / "cache").exists()
