"""metrics.csv of a run: rows of numbers that survive a kill."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from torchgrasp.data.files import write_text_atomically, writing
from torchgrasp.documents import read_text, shorten
from torchgrasp.errors import CheckpointError

if TYPE_CHECKING:
    from torchrl.record.loggers import Logger


_REMEDY = "restore it from a copy, or delete it"
_MAX_BYTES = 1 << 27


class MetricsLogger:
    """Appends rows of numbers to `<run_dir>/metrics.csv`, and hands them on to a logger of TorchRL.

    The first column is `step`. A metric that appears later adds a column, empty in earlier rows. TorchRL's
    own CSVLogger has a file for each metric, and no resume.

    Args:
        run_dir: made if missing.
        resume_step: rows at and after this step, written after the checkpoint that a run resumes
            from, are dropped. None starts a new file.
        logger: of `make_logger` or any other of TorchRL; `close` closes it too.
    """

    def __init__(
        self, run_dir: str | Path, *, resume_step: int | None = None, logger: Logger | None = None
    ) -> None:
        self._path = Path(run_dir) / "metrics.csv"
        with writing(self._path.parent):
            self._path.parent.mkdir(parents=True, exist_ok=True)
        self._columns = ["step"]
        self._rewrite(self._read_rows(resume_step))
        self._logger = logger

    def log(self, step: int, metrics: Mapping[str, float]) -> None:
        """Write one row, flushed to disk."""
        new = [name for name in metrics if name not in self._columns]
        if new:
            rows = self._read_rows(math.inf)
            self._columns += new
            self._rewrite(rows)
        row = {"step": step, **{name: _to_text(value) for name, value in metrics.items()}}
        with writing(self._path), self._path.open("a", newline="") as stream:
            csv.DictWriter(stream, self._columns, restval="").writerow(row)
        if self._logger is not None:
            # All at once: in W&B a row for each step, in MLflow one request.
            self._logger.log_metrics({name: float(value) for name, value in metrics.items()}, step=step)

    def close(self) -> None:
        """Close the logger; metrics.csv is always whole."""
        if self._logger is not None:
            self._logger.close()

    def _read_rows(self, before_step: float | None) -> list[dict[str, str]]:
        if before_step is None or not self._path.exists():
            return []
        names, cells = read_cells(self._path)
        self._columns = names or self._columns
        rows = [dict(zip(names, row, strict=True)) for row in cells]
        return [row for row in rows if _step(row, self._path) < before_step]

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        stream = io.StringIO()
        writer = csv.DictWriter(stream, self._columns, restval="", extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
        write_text_atomically(self._path, stream.getvalue())


def _to_text(value: float) -> str:
    value = float(value)
    return str(int(value)) if value.is_integer() else repr(value)


def read_cells(path: Path) -> tuple[list[str], list[list[str]]]:
    """The columns' names and the cells of each row of a metrics.csv; a line that a kill cut off is left out.

    CheckpointError names a file that cannot be read, or whose first line names no column `step` or one twice.
    """
    text = read_text(path, _REMEDY, at_most=_MAX_BYTES)
    try:
        names, *rows = list(csv.reader(io.StringIO(text, newline=""))) or [[]]
    except csv.Error as error:
        raise CheckpointError(f"{path} cannot be used ({error}): {_REMEDY}.") from error
    if names and ("step" not in names or len(set(names)) < len(names)):
        raise CheckpointError(
            f"{path} begins with {shorten(names)}, not with the names of columns, step among them: {_REMEDY}."
        )
    return names, [row for row in rows if len(row) == len(names)]


def _step(row: dict[str, str], path: Path) -> int:
    try:
        return int(row["step"])
    except ValueError as error:
        raise CheckpointError(
            f"{path} has a row whose step is {shorten(row['step'])}, no whole number: {_REMEDY}."
        ) from error
