"""Resident memory of this process and of the processes it started."""

from __future__ import annotations

from contextlib import suppress

import psutil


def measure_memory() -> dict[str, float]:
    """Megabytes (1e6 bytes) that are resident now, as columns of metrics.csv.

    `memory/process_mb` is this process and `memory/children_mb` all its descendants; pages that processes
    share count in each of them.

    >>> measure_memory()["memory/process_mb"] > 0
    True
    """
    process = psutil.Process()
    children = sum(_resident(child) for child in process.children(recursive=True))
    return {"memory/process_mb": _resident(process), "memory/children_mb": children}


def _resident(process: psutil.Process) -> float:
    """Megabytes; 0 of a process that has just ended."""
    with suppress(psutil.NoSuchProcess):
        return process.memory_info().rss / 1e6
    return 0.0
