"""Errors of the user's making, and interruptions, as one line without a traceback."""

from __future__ import annotations

import os
import select
import sys
from contextlib import ContextDecorator, ExitStack, suppress

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode

from torchgrasp.errors import TorchgraspError
from torchgrasp.interruption import Interrupted, end_at_once, release, watch_signals
from torchgrasp.names import one_line


class JobInterruptedError(TorchgraspError):
    """A job of a sweep that a signal ended: an error, so that Hydra comes to the end of the sweep."""


class _OneLineErrors(ContextDecorator):
    """What `one_line_errors` returns; a class, because parallel launchers pickle what it decorates."""

    def __enter__(self) -> None:
        self._opened = ExitStack()
        self._opened.enter_context(watch_signals())
        try:
            self._opened.enter_context(release())
        except Interrupted as interruption:  # before this job of a sweep began
            self.__exit__(Interrupted, interruption, None)
            raise

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._opened.close()
        closed = _drop_unread()
        if isinstance(error, KeyboardInterrupt):
            self._end_interrupted(error)
        cause = find_cause(error) if isinstance(error, Exception) else None
        if _in_sweep():
            return
        if closed and isinstance(error, BrokenPipeError):
            raise SystemExit(1) from None
        if error is None or cause is None:
            return
        _tell(f"error: {tell_in_line(cause, error)}")
        raise SystemExit(1) from None

    def _end_interrupted(self, error: KeyboardInterrupt) -> None:
        if _in_sweep() and "sweep" in HydraConfig.get().callbacks:
            raise JobInterruptedError(str(error)) from None
        end_at_once()
        _tell(tell_in_line(error))
        raise SystemExit(error.exit_code if isinstance(error, Interrupted) else 130) from None


def _in_sweep() -> bool:
    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def tell_in_line(*errors: BaseException) -> str:
    """What the first one says, and the notes of one line that were added to any of them."""
    notes = [note for error in errors for note in getattr(error, "__notes__", ()) if "\n" not in note]
    told = one_line(errors[0]) or type(errors[0]).__name__
    ended = told if not notes or told.endswith(".") else f"{told}."
    return " ".join((ended, *dict.fromkeys(notes)))


def _drop_unread() -> bool:
    """Whether nobody reads standard output any longer, as behind `| head`; what is left goes nowhere then."""
    with suppress(BrokenPipeError):
        sys.stdout.flush()
    try:
        poll = select.poll()
        poll.register(sys.stdout.fileno(), select.POLLOUT)
    except (AttributeError, OSError, ValueError):  # no such call on this system, or no file
        return False
    closed = any(events & select.POLLERR for _, events in poll.poll(0))
    if closed:  # else the interpreter would complain of it when it ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return closed


def one_line_errors() -> ContextDecorator:
    """Print a TorchgraspError, or one that caused another error, as `error: ...` and exit with code 1.

    What ctrl-C or SIGTERM interrupts ends with one line too, which tells how to go on, and exit code 130 or
    143. Output that nobody reads any longer, as behind `| head`, ends without a word.

    As a decorator it stands below `recipe_main`, in which Hydra would print a traceback itself:

        @recipe_main(config_name="td3_bc")
        @one_line_errors()
        def main(cfg): ...

    In a job of a sweep the error goes on: Hydra runs the other jobs, `SweepRecord` prints it. After a signal
    no further job begins.
    """
    return _OneLineErrors()


def find_cause(error: BaseException | None) -> TorchgraspError | None:
    """The TorchgraspError in an error's chain of causes, as under Hydra's InstantiationException."""
    while error is not None and not isinstance(error, TorchgraspError):
        error = error.__cause__
    return error
