"""Errors of the user's making as one line, without a traceback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from torchgrasp.errors import TorchgraspError


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Print a TorchgraspError, or one that caused another error, as `error: ...` and exit with code 1.

    As a decorator it stands below Hydra's, which would print a traceback itself:

        @hydra.main(version_base=None, config_path="../conf", config_name="td3_bc")
        @one_line_errors()
        def main(cfg): ...
    """
    try:
        yield
    except Exception as error:
        cause = find_cause(error)
        if cause is None:
            raise
        print("error:", " ".join(str(cause).split()), file=sys.stderr)
        raise SystemExit(1) from None


def find_cause(error: BaseException | None) -> TorchgraspError | None:
    """The TorchgraspError in an error's chain of causes, as under Hydra's InstantiationException."""
    while error is not None and not isinstance(error, TorchgraspError):
        error = error.__cause__
    return error
