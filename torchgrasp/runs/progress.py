"""Progress: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TextIO

from tqdm import tqdm


class Progress:
    """Shows how far a run is, its success rate and the time to go, on standard error.

    On a terminal this is tqdm's bar. In a log file it is a line every `interval` seconds.

    Args:
        total: steps of the whole run.
        initial: steps done before, by the run that this one resumes.
        description: stands in front.
        unit: what a step is.
        interval: seconds between lines where there is no terminal.
        stream: where to write; standard error if None.
    """

    def __init__(
        self,
        total: int,
        *,
        initial: int = 0,
        description: str = "",
        unit: str = "step",
        interval: float = 30.0,
        stream: TextIO | None = None,
    ) -> None:
        self._stream = stream or sys.stderr
        terminal = self._stream.isatty()
        self._bar = tqdm(
            total=total,
            initial=initial,
            desc=description,
            unit=unit,
            file=self._stream,
            dynamic_ncols=True,
            disable=not terminal,
        )
        self._terminal, self._interval = terminal, interval
        self._total, self._done, self._initial = total, initial, initial
        self._description, self._unit, self._rate = description, unit, ""
        self._start = self._last = time.monotonic()

    def update(self, num_steps: int = 1, *, success_rate: float | None = None) -> None:
        """Add `num_steps`; `success_rate` in [0, 1] is shown until the next one."""
        self._done += num_steps
        if success_rate is not None:
            self._rate = f"success {100 * success_rate:.0f} %"
            self._bar.set_postfix_str(self._rate, refresh=False)
        self._bar.update(num_steps)
        if not self._terminal and time.monotonic() - self._last >= self._interval:
            self._print_line()

    def close(self) -> None:
        """End the bar, or print the last line."""
        self._bar.close()
        if not self._terminal:
            self._print_line()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _print_line(self) -> None:
        self._last = time.monotonic()
        elapsed, done = self._last - self._start, self._done - self._initial
        left = max(0, self._total - self._done)  # a round of episodes may go beyond the total
        to_go = tqdm.format_interval(left * elapsed / done) if done else "?"
        prefix = f"{self._description}: " if self._description else ""
        print(
            f"{prefix}{self._done}/{self._total} {self._unit}s, {tqdm.format_interval(elapsed)} elapsed, "
            f"{to_go} to go{self._rate and ', ' + self._rate}",
            file=self._stream,
            flush=True,
        )
