"""What a replay buffer costs, and a refusal before it costs more than there is."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.data.compact import CompactTransitions
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import gripper_control_points

# Where a row's successor is; its place in the list of draws, and the list.
_INDICES = 3 * 8
# A float64 weight, and the most that the sums above it take of a 128th of that each.
_WEIGHT = 9


def count_row_bytes(rows: TensorDictBase, *, prioritised: bool = False) -> int:
    """Bytes that each of the encoded `rows` (R, at least one) takes in a buffer, sampler included."""
    columns = rows.values(True, True)
    stored = sum(column.element_size() * column[0].numel() for column in columns)
    return stored + _INDICES + prioritised * _WEIGHT


def estimate_bytes(
    num_rows: int,
    row: TensorDictBase | None = None,
    *,
    num_points: int = 1024,
    prioritised: bool = False,
) -> int:
    """Bytes that `num_rows` transitions take in a MixtureReplayBuffer, sampler included.

    Args:
        num_rows: transitions, and one more for each cut of a trajectory.
        row: encoded rows (R) like those to be stored: of a demonstration file, or the codec's
            `example_row`. By default clouds, as CompactTransitions() stores them.
        num_points: of those clouds, without the gripper's six.
        prioritised: whether the sampler has a priority.

    >>> f"{estimate_bytes(2_000_000) / 1e9:.1f} GB"
    '12.5 GB'
    >>> codec = CompactTransitions(points_key=None, image_channels="rgbd")
    >>> row = codec.example_row({"image": (4, 112, 112), "time_left": (1,)})
    >>> f"{estimate_bytes(200_000, row) / 1e9:.1f} GB"
    '12.6 GB'
    """
    if row is None:
        cloud = (num_points + len(gripper_control_points()), 4)
        row = CompactTransitions().example_row({keys.POINTS: cloud, keys.TIME_LEFT: (1,)})
    return num_rows * count_row_bytes(row, prioritised=prioritised)


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


def check_space(num_rows: int, row_bytes: int, *, folder: str | Path | None = None) -> None:
    """Raise ConfigError where `num_rows` rows of `row_bytes` do not fit the memory, or the disk at `folder`.

    The message says how many rows of that size would fit.
    """
    if folder is None:
        free, where = available_memory(), "of memory"
        remedy = "store it on disk (folder=<directory>)"
    else:
        existing = next(p for p in (Path(folder).absolute(), *Path(folder).absolute().parents) if p.exists())
        free, where = shutil.disk_usage(existing).free, f"of disk below {existing}"
        remedy = "name a folder on a larger disk"
    if num_rows * row_bytes > free:
        raise ConfigError(
            f"The replay buffer needs {num_rows * row_bytes / 1e9:.1f} GB for {num_rows} transitions of "
            f"{row_bytes} bytes, and {free / 1e9:.1f} GB {where} are free: {free // row_bytes} such "
            f"transitions would fit. Lower the capacities to that, use fewer points or pixels, or {remedy}."
        )
