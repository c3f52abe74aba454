"""Ctrl-C and SIGTERM: the first ends what runs in good order, a second ctrl-C at once.

`watch_signals` turns the first signal into `Interrupted`. Where that would leave something half done, `hold`
puts it off until the next `check` or `release`. Worker processes leave signals to whoever started them
(`torchgrasp.processes`).
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from torchgrasp.errors import StorageError, WorkerError

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_QUIET_TRACKER = "ignore:resource_tracker:UserWarning"


class Interrupted(KeyboardInterrupt):
    """The first ctrl-C or SIGTERM; like KeyboardInterrupt it passes every `except Exception`.

    How to go on afterwards is added to it as notes (`add_note`), one line each.

    Attributes:
        number: of the signal.

    >>> interruption = Interrupted(signal.SIGTERM)
    >>> str(interruption), interruption.exit_code
    ('interrupted by SIGTERM', 143)
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number

    def __str__(self) -> str:
        return f"interrupted by {signal.Signals(self.number).name}"

    @property
    def exit_code(self) -> int:
        """What a shell reports of a process that the signal ended: 130 or 143."""
        return 128 + self.number


# What ends a run that goes on later where it stopped.
UNTIMELY = (Interrupted, StorageError, WorkerError)


class _Watch:
    """Of this process: whether signals are watched, the first one that came, and who else is told of it."""

    active = False
    received: int | None = None
    tell: Callable[[], None] | None = None


class _Hold(threading.local):
    """Of each thread: how many `hold` are open."""

    depth = 0


_watch, _hold = _Watch(), _Hold()


@contextmanager
def watch_signals(*, tell: Callable[[], None] | None = None) -> Iterator[None]:
    """Within the block the first SIGINT or SIGTERM raises `Interrupted`, unless a `hold` puts it off.

    From then on SIGINT ends the process at once, and SIGTERM, which schedulers repeat, is ignored. Python
    tells signals to the main thread alone: in another one, or within another watch, nothing changes. A signal
    that the process was started to ignore stays ignored. After the block all is as before.

    Args:
        tell: is called when the first signal comes.
    """
    if _watch.active or threading.current_thread() is not threading.main_thread():
        yield
        return
    # A process that ends at once leaves semaphores to Python's tracker, which takes these options when it is
    # started. It removes them, and need not tell.
    sys.warnoptions.append(_QUIET_TRACKER)
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    _watch.active, _watch.tell = True, tell
    for number in _SIGNALS:
        if before[number] is not signal.SIG_IGN:
            signal.signal(number, _take)
    try:
        yield
    finally:
        _watch.active, _watch.received, _watch.tell = False, None, None
        sys.warnoptions.remove(_QUIET_TRACKER)
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _take(number: int, _: FrameType | None) -> None:
    _watch.received = number
    end_at_once()
    if _watch.tell is not None:
        _watch.tell()
    if not _hold.depth:
        raise Interrupted(number)
    if number == signal.SIGINT:  # not by `print`, which this may have come in the middle of
        os.write(2, b"\nctrl-C: saving what there is; once more ends at once, without.\n")


def end_at_once() -> None:
    """From now on ctrl-C ends this process at once, by the kernel, and SIGTERM is ignored."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


@contextmanager
def hold() -> Iterator[None]:
    """Put a signal off within the block: it is raised by the next `check` or `release`."""
    _hold.depth += 1
    try:
        yield
    finally:
        _hold.depth -= 1


@contextmanager
def release() -> Iterator[None]:
    """Let signals be raised at once again within the block, and first of all the one that was put off."""
    depth, _hold.depth = _hold.depth, 0
    try:
        check()
        yield
    finally:
        _hold.depth = depth


def check() -> None:
    """Raise `Interrupted` where a signal has come."""
    if _watch.received is not None:
        raise Interrupted(_watch.received)


def is_interrupted() -> bool:
    """Whether a signal has come."""
    return _watch.received is not None


@contextmanager
def noted(way_on: str) -> Iterator[None]:
    """Add how to go on to what ends the block before its time: a signal, a full disk, dead workers."""
    try:
        yield
    except UNTIMELY as error:
        error.add_note(way_on)
        raise


@contextmanager
def keep_handlers() -> Iterator[None]:
    """Undo what the block, code of others, does to the handlers of signals."""
    mine = threading.current_thread() is threading.main_thread()
    before = {number: signal.getsignal(number) for number in _SIGNALS} if mine else {}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        if is_interrupted():
            end_at_once()
