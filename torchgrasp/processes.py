"""What every process that this library starts keeps to: signals are its parent's, and it ends with it."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe, wait

from torchgrasp.errors import TorchgraspError

_LOOK_EVERY = 0.5  # seconds between two looks at whether the parent is still there


def serve_parent(sentinel: int | None = None) -> None:
    """Leave ctrl-C and SIGTERM to the process that started this one, and end when that one does.

    Args:
        sentinel: see `end_with_parent`.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    end_with_parent(sentinel)


def end_with_parent(sentinel: int | None = None) -> None:
    """End this process, whatever it is doing, when the one that started it is gone.

    Args:
        sentinel: a pipe of which the parent holds the other end and into which it writes nothing: the system
            closes it when the parent is killed. None for a process of multiprocessing or joblib.
    """
    parent = multiprocessing.parent_process()
    if sentinel is not None:
        target, args = _end_with_pipe, (sentinel,)
    elif parent is not None and parent.pid is not None:
        target, args = _end_with_process, (parent.pid,)
    else:
        return
    threading.Thread(target=target, args=args, daemon=True).start()


def _end_with_pipe(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def _end_with_process(parent: int) -> None:
    while os.getppid() == parent:  # another process adopts this one when its parent ends
        time.sleep(_LOOK_EVERY)
    os._exit(1)


def tell_end(code: int | None) -> str:
    """How a process ended, after "Worker 0 (process 7)".

    >>> tell_end(3), tell_end(-15)
    ('ended by itself with exit code 3', 'was killed by SIGTERM')
    """
    if code is None or code >= 0:
        return f"ended by itself with exit code {code}"
    name = signal.Signals(-code).name
    return f"was killed by {name}" + (", as it happens when memory runs out" if name == "SIGKILL" else "")


def count_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class HelperProcess:
    """Another process that calls `work` with the numbers that it is sent.

    Not one of multiprocessing's: those run the caller's script again, up to its main guard.

    Args:
        work: a pickled function of a whole number.
    """

    def __init__(self, work: bytes) -> None:
        self.pipe, theirs = Pipe()
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve({theirs.fileno()})"
        )
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,  # stays empty: the process ends when the system closes it
            pass_fds=[theirs.fileno()],
            env={**os.environ, "OMP_NUM_THREADS": "1"},  # each has one core
        )
        theirs.close()
        with suppress(OSError):  # it ended at once: `finish` tells
            self.pipe.send_bytes(work)

    def begin(self, index: int) -> None:
        """Have `work` called with a number."""
        with suppress(OSError):
            self.pipe.send(index)

    def finish(self) -> str | None:
        """Wait until that is done, and raise what it raised; how the process ended, where it died at it."""
        try:
            error = self.pipe.recv()
        except (EOFError, OSError):
            return tell_end(self._process.wait())
        if error is not None:
            raise error
        return None

    def kill(self) -> None:
        """End the process; what it has not finished is not missed."""
        self._process.kill()
        self._process.wait()
        self.pipe.close()
        if self._process.stdin is not None:
            self._process.stdin.close()


def serve(descriptor: int) -> None:
    """The life of a HelperProcess: called in it, with its end of the pipe."""
    serve_parent(sys.stdin.fileno())
    pipe = Connection(descriptor)
    work = pickle.loads(pipe.recv_bytes())
    with suppress(EOFError):
        while True:
            pipe.send(_attempt(work, pipe.recv()))


def _attempt(work: Callable[[int], None], index: int) -> Exception | None:
    try:
        work(index)
    except Exception as error:
        told = f"In another process:\n{traceback.format_exc()}"
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # of a class that cannot travel
            return RuntimeError(told)
        if not isinstance(error, TorchgraspError):  # which says all in one line
            error.add_note(told)
        return error
    return None
