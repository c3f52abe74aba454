"""Sweeps as a user would start them."""

import json
from pathlib import Path

import pytest

from torchgrasp.runs.sweep_record import read_sweep

SMOKE = ("experiment=smoke", "evaluation.baselines=[]")


def find_sweep(root: Path) -> Path:
    (folder,) = root.glob("sweeps/*")
    return folder


def test_two_seeds_train_one_fails_and_the_rest_is_compared(run_recipe, tmp_path):
    code, out, err = run_recipe(
        "td3_bc", *SMOKE, "total_env_steps=0", "seed=0,1", "pretrain.steps=6,-1", "-m"
    )
    assert code == 1, err
    assert "2 of 4 jobs finished" in out and out.count(" failed: output_dir=") == 2
    assert err.count("error: job") == 2 and "Traceback" not in err
    folder = find_sweep(tmp_path)
    jobs = read_sweep(folder)
    assert [job.ended for job in jobs] == [True, False, True, False]
    assert all("pretrain.steps=-1" in (job.failure or "") for job in jobs if not job.ended)
    directories = {job.run_dir for job in jobs if job.ended}
    assert len(directories) == 2 == len(list(tmp_path.glob("td3_bc/*")))
    assert [json.loads((each / "summary.json").read_text())["episodes"] for each in directories] == [4, 4]
    assert not Path("multirun").exists() and {path.name for path in tmp_path.iterdir()} == {
        "td3_bc",
        "sweeps",
    }

    line = next(line for line in out.splitlines() if line.startswith("Compare them: "))
    code, out, err = run_recipe("compare", line.split()[-1])
    assert code == 0, err
    assert "pretrain.steps=6  0, 1" in out


@pytest.mark.slow
def test_jobs_side_by_side_have_directories_of_their_own(run_recipe, tmp_path):
    launcher = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "collector.num_workers=1")
    code, out, err = run_recipe("td3_bc", *SMOKE, *launcher, "seed=0,1", "total_env_steps=0", "-m")
    assert code == 0, err
    assert "2 of 2 jobs finished" in out
    jobs = read_sweep(find_sweep(tmp_path))
    seeds = [(job.run_dir / "config.yaml").read_text().splitlines()[0] for job in jobs if job.run_dir]
    assert seeds == ["seed: 0", "seed: 1"]
