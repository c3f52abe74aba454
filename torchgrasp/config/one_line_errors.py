"""Errors of the user's making as one line, without a traceback."""

from __future__ import annotations

import os
import select
import sys
from contextlib import ContextDecorator, suppress

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode

from torchgrasp.errors import TorchgraspError
from torchgrasp.names import one_line


class _OneLineErrors(ContextDecorator):
    """What `one_line_errors` returns; a class, because parallel launchers pickle what it decorates."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        closed = _drop_unread()
        cause = find_cause(error) if isinstance(error, Exception) else None
        if HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN:
            return
        if closed and isinstance(error, BrokenPipeError):
            raise SystemExit(1) from None
        if cause is None:
            return
        print("error:", one_line(cause), file=sys.stderr)
        raise SystemExit(1) from None


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

    Output that nobody reads any longer, as behind `| head`, ends without a word.

    As a decorator it stands below `recipe_main`, in which Hydra would print a traceback itself:

        @recipe_main(config_name="td3_bc")
        @one_line_errors()
        def main(cfg): ...

    In a job of a sweep the error goes on: Hydra runs the other jobs, `SweepRecord` prints it.
    """
    return _OneLineErrors()


def find_cause(error: BaseException | None) -> TorchgraspError | None:
    """The TorchgraspError in an error's chain of causes, as under Hydra's InstantiationException."""
    while error is not None and not isinstance(error, TorchgraspError):
        error = error.__cause__
    return error
