"""Learning curves: mean and one standard deviation over runs that differ in their seed (Fig. 7)."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from torchgrasp.data.files import write_text_atomically
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs.metrics import read_cells

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Curve:
    """One run's values: `x` (P,) increasing, `y` (P,), and the run's name."""

    run: str
    x: Array
    y: Array


@dataclass(frozen=True, eq=False)
class LearningCurve:
    """Mean and sample standard deviation of R runs at `x` (P,); `std` is NaN for a single run."""

    x: Array
    mean: Array
    std: Array
    runs: int


def read_metrics(run_dir: str | Path) -> dict[str, Array]:
    """Columns (rows,) of a run directory's metrics.csv by name, NaN where a cell is empty.

    A value that was logged but is no finite number is inf. A line that a kill cut off is left out.

    Raises:
        CheckpointError: where the file is missing, empty or holds words.
    """
    path = Path(run_dir) / "metrics.csv"
    if not path.is_file():
        raise CheckpointError(f"There is no {path}: give the directory of a training run.")
    names, rows = read_cells(path)
    try:
        table = np.array([[_read_cell(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise CheckpointError(f"{path} is damaged ({error}): restore it from a copy.") from error
    if not len(table):
        raise CheckpointError(f"{path} has no rows yet: wait until the run has logged some.")
    return dict(zip(names, table.T, strict=True))


def read_curve(run_dir: str | Path, metric: str, *, x: str = "step") -> Curve:
    """The rows of a run's metrics.csv in which both columns `x` and `metric` stand.

    Where `x` goes back, as in a file joined from a run and the run that resumed it, the later rows hold.

    Raises:
        ConfigError: where a column is missing, the two never stand in one row, or the metric diverged.
    """
    columns = read_metrics(run_dir)
    for name in (metric, x):
        if name not in columns:
            raise ConfigError(f"{run_dir} has no {name!r} in metrics.csv: choose from {', '.join(columns)}.")
    both = ~np.isnan(columns[x]) & ~np.isnan(columns[metric])
    if not both.any():
        raise ConfigError(
            f"{run_dir}: {metric!r} and {x!r} never stand in one row of metrics.csv: give x=step."
        )
    at, values = columns[x][both], columns[metric][both]
    if not np.isfinite(values).all():
        bad = at[~np.isfinite(values)][0]
        raise ConfigError(f"{run_dir}: {metric!r} is no number from {x}={bad:g} on: leave the run out.")
    later = np.minimum.accumulate(at[::-1])[::-1]  # the least x of a row and of all after it
    kept = np.append(at[:-1] < later[1:], True)
    return Curve(Path(run_dir).name, at[kept], values[kept])


def average_curves(curves: Sequence[Curve]) -> LearningCurve:
    """Mean and sample standard deviation (divisor R - 1) of R curves at every x that any of them has.

    Between its own points a curve is interpolated linearly; nothing is extrapolated, so that the result
    covers the range that all curves share and every point of it is a mean over all of them.

    Example:
        >>> short = Curve("a", np.array([0.0, 2.0]), np.array([0.0, 1.0]))
        >>> long = Curve("b", np.array([0.0, 1.0, 4.0]), np.array([0.0, 1.0, 1.0]))
        >>> average = average_curves([short, long])
        >>> average.x.tolist(), average.mean.tolist()
        ([0.0, 1.0, 2.0], [0.0, 0.75, 1.0])
    """
    if not curves:
        raise ConfigError("There are no curves to average: give at least one run.")
    first, last = max(curves, key=lambda each: each.x[0]), min(curves, key=lambda each: each.x[-1])
    low, high = first.x[0], last.x[-1]
    if low > high:
        raise ConfigError(
            f"{last.run} ends at {high:g}, before {first.run} begins at {low:g}: average runs that overlap."
        )
    x = np.unique(np.concatenate([each.x for each in curves]))
    x = x[(x >= low) & (x <= high)]
    values = np.stack([np.interp(x, each.x, each.y) for each in curves])
    alone = len(curves) == 1
    std = np.full(len(x), np.nan) if alone else values.std(axis=0, ddof=1)
    return LearningCurve(x, values.mean(axis=0), std, len(curves))


def write_curves_csv(path: str | Path, curves: Mapping[str, LearningCurve], *, x: str = "step") -> None:
    """Write a table with a row a point: label, `x`, mean, std (empty for a single run), runs."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(("label", x, "mean", "std", "runs"))
    for label, curve in curves.items():
        for at, mean, std in zip(curve.x.tolist(), curve.mean.tolist(), curve.std.tolist(), strict=True):
            spread = "" if math.isnan(std) else std
            writer.writerow((label, int(at) if at.is_integer() else at, mean, spread, curve.runs))
    write_text_atomically(path, stream.getvalue())


def _read_cell(text: str) -> float:
    value = float(text or "nan")
    return value if not text or np.isfinite(value) else np.inf
