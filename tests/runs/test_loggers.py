"""The loggers beside metrics.csv: what their own readers find below the run directory."""

import sys

import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.runs.loggers import make_logger
from torchgrasp.runs.metrics import MetricsLogger


def log_and_resume(run_dir, kind: str, **options) -> None:
    """Steps 0 to 4 with the losses 0 to 4; then from step 3, as after a kill, losses of 30 and 40."""
    metrics = MetricsLogger(run_dir, logger=make_logger(kind, run_dir, **options))
    for step in range(5):
        metrics.log(step, {"critic/loss": step, "rate": 0.5})
    metrics.close()
    logger = make_logger(kind, run_dir, resume_step=3, **options)
    metrics = MetricsLogger(run_dir, resume_step=3, logger=logger)
    for step in (3, 4):
        metrics.log(step, {"critic/loss": 10 * step})
    metrics.close()


def test_csv_needs_no_logger(tmp_path):
    assert make_logger("csv", tmp_path) is None and not list(tmp_path.iterdir())


def test_tensorboard_has_no_step_twice_after_a_resume(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log_and_resume(tmp_path, "tensorboard")
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    found = [(event.step, event.value) for event in events.Scalars("critic/loss")]
    assert found == [(0, 0), (1, 1), (2, 2), (3, 30), (4, 40)]
    assert [event.step for event in events.Scalars("rate")] == [0, 1, 2]


def test_wandb_writes_without_a_network_and_goes_on_with_the_same_run(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "online")  # TorchRL's logger sets it; here it is set back afterwards
    log_and_resume(tmp_path / "bc" / "run", "wandb", project="grasping", offline=True)
    folders = sorted((tmp_path / "bc" / "run" / "wandb").glob("offline-run-*"))
    files = [file for folder in folders for file in folder.glob("run-*.wandb")]
    assert files and len({file.name for file in files}) == 1  # one id
    content = b"".join(file.read_bytes() for file in files)
    assert b"critic/loss" in content and b"grasping" in content and b"bc run" in content


def test_mlflow_keeps_a_database_below_the_run(tmp_path):
    import mlflow

    run_dir = tmp_path / "bc" / "run"
    log_and_resume(run_dir, "mlflow")
    client = mlflow.MlflowClient(f"sqlite:///{run_dir / 'mlflow' / 'mlflow.db'}")
    (experiment,) = client.search_experiments(filter_string="name = 'torchgrasp'")
    later, first = client.search_runs([experiment.experiment_id])
    assert first.info.run_name == "bc run" and {first.info.status, later.info.status} == {"FINISHED"}
    history = [
        [(row.step, row.value) for row in client.get_metric_history(run.info.run_id, "critic/loss")]
        for run in (first, later)
    ]
    assert history == [[(step, step) for step in range(5)], [(3, 30), (4, 40)]]


@pytest.mark.parametrize(
    ("package", "remedy"),
    [
        ("tensorboard", r'pip install "torchgrasp\[viz\]"'),
        ("wandb", r'pip install "torchgrasp\[wandb\]"'),
        ("mlflow", r'pip install "torchgrasp\[mlflow\]"'),
    ],
)
def test_a_missing_package_is_told_with_its_remedy(tmp_path, monkeypatch, package, remedy):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=remedy):
        make_logger(package, tmp_path)


def test_what_is_no_logger_or_no_option_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"kind='neptune' .* csv, tensorboard, wandb, mlflow"):
        make_logger("neptune", tmp_path)
    with pytest.raises(ConfigError, match=r"tensorboard does not take .*\(offline\)"):
        make_logger("tensorboard", tmp_path, offline=True)
