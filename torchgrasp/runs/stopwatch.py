"""Where a training loop's time goes, and whether its memory grows: columns for metrics.csv."""

from __future__ import annotations

import time

from torchgrasp.runs.process_memory import measure_memory


class Stopwatch:
    """Laps of a loop: each names what was done since the last one.

    A lap costs microseconds. Memory is read every `interval` seconds at most: in between its columns stay
    empty.

    Args:
        interval: seconds between two readings of memory.

    Example:
        >>> stopwatch = Stopwatch()
        >>> stopwatch.lap("rollouts", 420, of="env_steps")
        >>> stopwatch.lap("updates", 20)
        >>> [name for name in stopwatch.measure() if not name.startswith("memory")]
        ['time/rollouts_s', 'time/updates_s', 'speed/env_steps_per_s', 'speed/updates_per_s']
    """

    def __init__(self, *, interval: float = 5.0) -> None:
        self._interval = interval
        self._seconds: dict[str, float] = {}
        self._counts: dict[str, tuple[str, int]] = {}
        self._last = time.perf_counter()
        self._next_reading = self._last

    def lap(self, part: str, count: int = 0, *, of: str | None = None) -> None:
        """Count the time since the last lap to `part`, in which `count` things, named `of`, were done."""
        now = time.perf_counter()
        self._seconds[part] = self._seconds.get(part, 0.0) + now - self._last
        self._last = now
        if count:
            self._counts[part] = (of or part, self._counts.get(part, ("", 0))[1] + count)

    def measure(self) -> dict[str, float]:
        """Seconds of each part and things a second since the last call, and megabytes now and then."""
        found = {f"time/{part}_s": seconds for part, seconds in self._seconds.items()}
        for part, (name, count) in self._counts.items():
            found[f"speed/{name}_per_s"] = count / max(self._seconds[part], 1e-9)
        if time.perf_counter() >= self._next_reading:
            found |= measure_memory()
            self._next_reading = time.perf_counter() + self._interval
        self._seconds, self._counts = {}, {}
        return found
