"""Seconds by part, for the benchmark."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Clock:
    """Seconds by part, exclusive of parts inside."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside = 0.0

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time spent inside as `name`."""
        outer, self._inside, start = self._inside, 0.0, time.perf_counter()
        try:
            yield
        finally:
            total = time.perf_counter() - start
            self.seconds[name] += total - self._inside
            self._inside = outer + total

    def wrap(self, owner: object, method: str, name: str) -> None:
        """Count every call of a method as `name`."""
        inner: Callable = getattr(owner, method)

        def timed(*args: object, **kwargs: object) -> object:
            with self.part(name):
                return inner(*args, **kwargs)

        setattr(owner, method, timed)
