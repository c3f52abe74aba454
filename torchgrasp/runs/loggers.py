"""TensorBoard, Weights & Biases and MLflow through TorchRL's loggers, their files below the run directory."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchgrasp.errors import ConfigError

if TYPE_CHECKING:
    from torchrl.record.loggers import Logger

_INSTALL = {
    "tensorboard": 'pip install "torchgrasp[viz]"',
    "wandb": 'pip install "torchgrasp[wandb]"',
    "mlflow": 'pip install "torchgrasp[mlflow]"',
}
_WANDB_FOLDER = re.compile(r"(?:offline-)?run-(\d{8}_\d{6})-(.+)")  # time, id


def make_logger(
    kind: str, run_dir: str | Path, *, resume_step: int | None = None, **options: Any
) -> Logger | None:
    """A logger of TorchRL for `MetricsLogger`; None for `csv`, since metrics.csv is written always.

    Args:
        kind: `csv`, `tensorboard`, `wandb` or `mlflow`.
        run_dir: TensorBoard's files go to its folder `tensorboard`, those of W&B to `wandb`, and MLflow's to
            `mlflow` unless `tracking_uri` names another store.
        resume_step: of a resumed run the first step that is logged again, None of a new run. TensorBoard
            drops what it has from there on. W&B goes on with the same run, where the steps after the
            checkpoint then stand twice. In MLflow the rest is another run of the same experiment.
        options: W&B: `project`, `offline` and what else `wandb.init` takes. MLflow: `project` (the
            experiment's name), `tracking_uri` and `tags`.

    Raises:
        ConfigError: where there is no such kind, its package is not installed, or it has no such option.

    Example:
        >>> make_logger("csv", "outputs/bc/2026-01-01_12-00-00") is None
        True
    """
    check_logger(kind)
    if kind == "csv":
        return None
    make = {"tensorboard": _make_tensorboard, "wandb": _make_wandb, "mlflow": _make_mlflow}[kind]
    try:
        return make(Path(run_dir).resolve(), resume_step, options)
    except TypeError as error:
        names = ", ".join(options) or "none"
        raise ConfigError(f"The logger {kind} does not take these options ({names}): {error}.") from error


def check_logger(kind: str) -> None:
    """Raise ConfigError where there is no such kind of logger, or its package is not installed."""
    if kind == "csv":
        return
    if kind not in _INSTALL:
        raise ConfigError(f"kind={kind!r} is no logger: choose from csv, {', '.join(_INSTALL)}.")
    try:
        import_module(kind)
    except ImportError as error:
        raise ConfigError(f"The logger {kind} is not installed ({error}): {_INSTALL[kind]}.") from error


def _make_tensorboard(run_dir: Path, resume_step: int | None, options: Mapping[str, Any]) -> Logger:
    from torch.utils.tensorboard import SummaryWriter
    from torchrl.record.loggers import TensorboardLogger

    class _Tensorboard(TensorboardLogger):
        """TorchRL's does not pass `purge_step` on."""

        def _create_experiment(self) -> SummaryWriter:
            return SummaryWriter(str(Path(self.log_dir, self.exp_name)), purge_step=resume_step)

    return _Tensorboard("tensorboard", str(run_dir), **options)


def _make_wandb(run_dir: Path, resume_step: int | None, options: Mapping[str, Any]) -> Logger:
    from torchrl.record.loggers import WandbLogger

    found = None if resume_step is None else _find_wandb_id(run_dir)
    return WandbLogger(_name(run_dir), save_dir=str(run_dir), **{"id": found, **options})


def _find_wandb_id(run_dir: Path) -> str | None:
    """The W&B run that a run directory was last logged to."""
    found = (_WANDB_FOLDER.fullmatch(path.name) for path in (run_dir / "wandb").glob("*run-*"))
    runs = sorted(folder.groups() for folder in found if folder is not None)
    return runs[-1][1] if runs else None


def _make_mlflow(run_dir: Path, resume_step: int | None, options: Mapping[str, Any]) -> Logger:
    import mlflow
    from torchrl.record.loggers import MLFlowLogger

    class _Mlflow(MLFlowLogger):
        """TorchRL's leaves the run open, so that the next one of the same process could not begin."""

        def shutdown(self, timeout: float | None = None) -> None:
            mlflow.end_run()
            super().shutdown(timeout)

    chosen: dict[str, Any] = {"project": "torchgrasp", "tracking_uri": None, **options}
    project, uri = chosen.pop("project"), chosen.pop("tracking_uri")
    if uri is None:  # since MLflow 3.10 a store on disk is a database
        store = run_dir / "mlflow"
        store.mkdir(parents=True, exist_ok=True)
        uri = f"sqlite:///{store / 'mlflow.db'}"
        chosen = {"artifact_location": (store / "artifacts").as_uri(), **chosen}
    logger = _Mlflow(project, uri, **chosen)
    mlflow.set_tag("mlflow.runName", _name(run_dir))
    return logger


def _name(run_dir: Path) -> str:
    """What a service shows of a run: recipe and time."""
    return f"{run_dir.parent.name} {run_dir.name}"
