"""What every process that this library starts keeps to: signals are its parent's, and it ends with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from multiprocessing.connection import wait

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
