"""What a replay buffer costs, and a refusal before it costs more than there is."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_SIZE, GOAL_SIZE

# time left, reward: float32; source, successor, draw list and its inverse: int64; 8 flags.
_SCALARS = 4 + 4 + 4 * 8 + 8


def estimate_bytes(num_steps: int, *, num_points: int = 1024) -> int:
    """Bytes that `num_steps` transitions take as CompactTransitions stores them, sampler included.

    `num_points` counts the object's points without the gripper's six, 6 bytes each.

    >>> f"{estimate_bytes(2_000_000) / 1e9:.1f} GB"
    '12.5 GB'
    """
    floats = 2 * ACTION_SIZE + GOAL_SIZE
    return num_steps * (6 * num_points + 4 * floats + _SCALARS)


def available_memory() -> int:
    """Bytes of memory that this process may still take, the container's limit included."""
    free = _meminfo_available()
    group = Path("/sys/fs/cgroup")
    try:
        limit, used = (int((group / name).read_text()) for name in ("memory.max", "memory.current"))
        stat = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
    except (OSError, ValueError):  # no control group, or its limit reads "max"
        return free
    # The kernel gives up its copies of files before it runs out.
    used -= int(stat.get("active_file", 0)) + int(stat.get("inactive_file", 0))
    return max(0, min(free, limit - used))


def _meminfo_available() -> int:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_space(num_bytes: int, *, folder: str | Path | None = None) -> None:
    """Raise ConfigError where `num_bytes` do not fit the memory, or the disk below `folder`."""
    if folder is None:
        free, where = available_memory(), "of memory"
        remedy = "store it on disk (replay.folder=<folder>)"
    else:
        existing = next(p for p in (Path(folder).absolute(), *Path(folder).absolute().parents) if p.exists())
        free, where = shutil.disk_usage(existing).free, f"of disk below {existing}"
        remedy = "name a folder on a larger disk"
    if num_bytes > free:
        raise ConfigError(
            f"The replay buffer needs {num_bytes / 1e9:.1f} GB and {free / 1e9:.1f} GB {where} are free: "
            f"lower the capacities, use fewer points, or {remedy}."
        )
