"""metrics.csv of a run: rows of numbers that survive a kill."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from torchgrasp.data.files import write_text_atomically
from torchgrasp.errors import CheckpointError


class MetricsLogger:
    """Appends rows of numbers to `<run_dir>/metrics.csv`, and to TensorBoard.

    The first column is `step`. A metric that appears later adds a column, empty in earlier rows.

    Args:
        run_dir: made if missing; TensorBoard's files go to its folder `tensorboard`.
        resume_step: rows at and after this step, written after the checkpoint that a run resumes
            from, are dropped. None starts a new file.
        tensorboard: False writes the CSV only.
    """

    def __init__(
        self, run_dir: str | Path, *, resume_step: int | None = None, tensorboard: bool = True
    ) -> None:
        self._path = Path(run_dir) / "metrics.csv"
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._columns = ["step"]
        self._rewrite(self._read_rows(resume_step))
        folder = str(Path(run_dir) / "tensorboard")
        self._writer = SummaryWriter(folder, purge_step=resume_step) if tensorboard else None

    def log(self, step: int, metrics: Mapping[str, float]) -> None:
        """Write one row, flushed to disk."""
        new = [name for name in metrics if name not in self._columns]
        if new:
            rows = self._read_rows(math.inf)
            self._columns += new
            self._rewrite(rows)
        row = {"step": step, **{name: _to_text(value) for name, value in metrics.items()}}
        with self._path.open("a", newline="") as stream:
            csv.DictWriter(stream, self._columns, restval="").writerow(row)
        for name, value in metrics.items():
            if self._writer is not None:
                self._writer.add_scalar(name, float(value), step)

    def close(self) -> None:
        """Flush TensorBoard's file."""
        if self._writer is not None:
            self._writer.close()

    def _read_rows(self, before_step: float | None) -> list[dict[str, str]]:
        if before_step is None or not self._path.exists():
            return []
        with self._path.open(newline="") as stream:
            reader = csv.DictReader(stream)
            rows = [
                row for row in reader if None not in row.values() and _step(row, self._path) < before_step
            ]
            self._columns = list(reader.fieldnames or self._columns)
        return rows

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        lines = [self._columns, *([row.get(name, "") for name in self._columns] for row in rows)]
        text = "".join(",".join(_quote(cell) for cell in line) + "\r\n" for line in lines)
        write_text_atomically(self._path, text)


def _to_text(value: float) -> str:
    value = float(value)
    return str(int(value)) if value.is_integer() else repr(value)


def _quote(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if any(c in cell for c in ',"\r\n') else cell


def _step(row: dict[str, str], path: Path) -> int:
    try:
        return int(row["step"])
    except (KeyError, ValueError) as error:
        raise CheckpointError(f"{path} has a row without a step: mend or delete the file.") from error
