"""Resident memory of this process and of the processes it started."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_PROC = Path("/proc")


def measure_memory() -> dict[str, float]:
    """Megabytes (1e6 bytes) that are resident now, as columns of metrics.csv.

    On Linux `memory/process_mb` is this process and `memory/children_mb` all its descendants; pages that
    processes share count in each of them. macOS tells only the highest so far, `memory/peak_mb`; where
    there is nothing to read, as on Windows, there is no column.

    >>> measure_memory().get("memory/process_mb", 1.0) > 0
    True
    """
    own = _resident(os.getpid())
    if own is not None:
        children = sum(_resident(pid) or 0.0 for pid in _descendants(os.getpid()))
        return {"memory/process_mb": own, "memory/children_mb": children}
    try:
        import resource
    except ImportError:
        return {}
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, kilobytes elsewhere
    return {"memory/peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6}


def _resident(pid: int) -> float | None:
    """Megabytes, None where /proc does not tell, as of a process that has just ended."""
    try:
        pages = int((_PROC / str(pid) / "statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _descendants(pid: int) -> list[int]:
    """Processes that a process started, and those that they started."""
    found: list[int] = []
    for task in (_PROC / str(pid) / "task").glob("*/children"):
        try:
            children = [int(child) for child in task.read_text().split()]
        except OSError:  # the thread has just ended
            continue
        found += [each for child in children for each in (child, *_descendants(child))]
    return found
