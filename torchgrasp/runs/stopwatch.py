"""Where a loop's time goes, and whether its memory grows: columns for metrics.csv."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps

from torchgrasp.runs.process_memory import measure_memory


class Stopwatch:
    """Seconds by part of a loop, each exclusive of the parts inside it, so that they add up to the whole.

    Here instead of `torchrl.timeit`, which keeps one registry for the whole process and counts the time of a
    part inside another one twice.

    A part costs microseconds. Memory is read every `interval` seconds at most: in between its columns stay
    empty. One thread uses a stopwatch.

    Args:
        interval: seconds between two readings of memory.

    Example:
        >>> stopwatch = Stopwatch()
        >>> with stopwatch.part("rollouts"):
        ...     stopwatch.count("rollouts", 420, of="env_steps")
        >>> with stopwatch.part("updates"):
        ...     stopwatch.count("updates", 20)
        >>> [name for name in stopwatch.measure() if not name.startswith("memory")]
        ['time/rollouts_s', 'time/updates_s', 'time/other_s', 'speed/env_steps_per_s', 'speed/updates_per_s']
    """

    def __init__(self, *, interval: float = 5.0) -> None:
        self._interval = interval
        self._seconds: dict[str, float] = {}
        self._outside = 0.0
        self._counts: dict[tuple[str, str], int] = {}
        self._open: list[str] = []
        self._last = self._next_reading = time.perf_counter()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time inside the `with` block as `name`, but for that of parts inside it."""
        self._charge()
        self._open.append(name)
        try:
            yield
        finally:
            self._charge()
            self._open.pop()

    def count(self, part: str, count: int, *, of: str | None = None) -> None:
        """Note that `count` things, named `of` or as the part, were done in `part`."""
        key = (part, of or part)
        self._counts[key] = self._counts.get(key, 0) + count

    def wrap(self, owner: object, method: str, name: str) -> None:
        """Count every call of `owner.method` as the part `name`, from now on."""
        inner: Callable = getattr(owner, method)

        @wraps(inner)
        def timed(*args: object, **kwargs: object) -> object:
            with self.part(name):
                return inner(*args, **kwargs)

        setattr(owner, method, timed)

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds of each part since the last `measure`, in the order in which they were first left."""
        self._charge()
        return dict(self._seconds)

    def measure(self) -> dict[str, float]:
        """Columns since the last call, all counts begun anew.

        `time/<part>_s` of each part and `time/other_s` outside every part, `speed/<of>_per_s` of what was
        counted in a part that took time, and now and then the megabytes of `measure_memory`.
        """
        seconds = self.seconds
        found = {f"time/{part}_s": value for part, value in seconds.items()}
        found["time/other_s"] = self._outside
        for (part, name), count in self._counts.items():
            if part in seconds and count:
                found[f"speed/{name}_per_s"] = count / max(seconds[part], 1e-9)
        if time.perf_counter() >= self._next_reading:
            found |= measure_memory()
            self._next_reading = time.perf_counter() + self._interval
        self._seconds, self._counts, self._outside = {}, {}, 0.0
        return found

    def _charge(self) -> None:
        """Put the time since the last change down to the innermost part that is open."""
        now = time.perf_counter()
        if self._open:
            self._seconds[self._open[-1]] = self._seconds.get(self._open[-1], 0.0) + now - self._last
        else:
            self._outside += now - self._last
        self._last = now
