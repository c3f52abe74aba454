"""Success rates with their uncertainty, by object, and why episodes failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from torchgrasp.evaluation.intervals import paired_interval, wilson_interval


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
        self._outcomes: list[bool] = []

    def add(self, object_name: str, success: bool, *, cause: str | None = None) -> None:
        """Count one finished episode, and why it failed where that is known."""
        if cause is not None:
            self._causes.setdefault(object_name, Counter())[cause] += 1
        counts = self._counts.setdefault(object_name, [0, 0])
        counts[0] += 1
        counts[1] += int(success)
        self._outcomes.append(bool(success))

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
        """What summary.json says of success: rate, 95 % interval, episodes, objects, failures.

        `outcomes` has a 1 for each success and a 0 for each failure, in the order of the scenes.
        """
        return {
            "success_rate": self.success_rate,
            "success_ci95": list(self.confidence_interval()),
            "episodes": self.episodes,
            "objects": self.rows(),
            "failures": self.failures(),
            "never_lifted": self.never_lifted(),
            "outcomes": "".join("1" if each else "0" for each in self._outcomes),
        }


def find_gain(table: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """By how much the success rate of one summary of a table is above that of another: `gain`, and `ci95`.

    Both are of the same scenes, in the same order, and so is the interval: the paired one.
    """
    outcomes = [*zip(table["outcomes"], before["outcomes"], strict=True)]
    gained, lost = outcomes.count(("1", "0")), outcomes.count(("0", "1"))
    interval = paired_interval(gained, lost, len(outcomes))
    return {"gain": table["success_rate"] - before["success_rate"], "ci95": list(interval)}
