"""Success rates with their uncertainty, and metrics on disk."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from statistics import NormalDist

from torch.utils.tensorboard import SummaryWriter

from torchgrasp.data.files import write_text_atomically
from torchgrasp.errors import CheckpointError


def wilson_interval(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """(low, high) of Wilson's score interval for a success rate; (0, 1) where nothing was tried.

    >>> [round(bound, 3) for bound in wilson_interval(264, 272)]
    [0.943, 0.985]
    """
    if n == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    rate = successes / n
    centre = (rate + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    # Exactly 0 and 1 at the ends, where rounding would leave a residue.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    return low, 1.0 if successes == n else min(1.0, centre + half)


class SuccessTable:
    """Counts of episodes and successes by object, or by any other name.

    >>> table = SuccessTable()
    >>> table.add("mug", True)
    >>> table.add("mug", False, cause="slipped")
    >>> row = table.rows()["mug"]
    >>> row["episodes"], row["successes"], row["success_rate"], row["failures"]
    (2, 1, 0.5, {'slipped': 1})
    """

    def __init__(self) -> None:
        self._counts: dict[str, list[int]] = {}
        self._causes: dict[str, Counter[str]] = {}

    def add(self, object_name: str, success: bool, *, cause: str | None = None) -> None:
        """Count one finished episode, and why it failed where that is known."""
        if cause is not None:
            self._causes.setdefault(object_name, Counter())[cause] += 1
        counts = self._counts.setdefault(object_name, [0, 0])
        counts[0] += 1
        counts[1] += int(success)

    @property
    def episodes(self) -> int:
        """Episodes of all objects."""
        return sum(episodes for episodes, _ in self._counts.values())

    @property
    def successes(self) -> int:
        """Successes of all objects."""
        return sum(successes for _, successes in self._counts.values())

    @property
    def success_rate(self) -> float:
        """Successes per episode; 0 before the first."""
        return self.successes / self.episodes if self.episodes else 0.0

    def confidence_interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Wilson's interval of the success rate."""
        return wilson_interval(self.successes, self.episodes, confidence)

    def rows(self) -> dict[str, dict]:
        """{name: row}, sorted by name.

        A row has `episodes`, `successes`, `success_rate`, `success_ci95` and `failures`, episodes by cause.
        """
        return {
            name: {
                "episodes": episodes,
                "successes": successes,
                "success_rate": successes / episodes,
                "success_ci95": list(wilson_interval(successes, episodes)),
                "failures": dict(self._causes.get(name, Counter()).most_common()),
            }
            for name, (episodes, successes) in sorted(self._counts.items())
        }

    def failures(self) -> dict[str, int]:
        """Episodes by cause of failure, the most frequent first."""
        return dict(sum(self._causes.values(), Counter()).most_common())

    def never_lifted(self) -> dict[str, str]:
        """Objects without one success, each with its most frequent cause."""
        never = [name for name, (_, successes) in sorted(self._counts.items()) if not successes]
        causes = {name: self._causes.get(name, Counter(["unknown"])) for name in never}
        return {name: counts.most_common(1)[0][0] for name, counts in causes.items()}

    def summary(self) -> dict:
        """What summary.json says of success: rate, 95 % interval, episodes, objects, failures."""
        return {
            "success_rate": self.success_rate,
            "success_ci95": list(self.confidence_interval()),
            "episodes": self.episodes,
            "objects": self.rows(),
            "failures": self.failures(),
            "never_lifted": self.never_lifted(),
        }


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
