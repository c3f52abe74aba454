"""Which results are of another version or an older commit than asked for, and of which it is not known."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from result_history import find_commit, is_in_history
from result_tables import NOT_RECORDED, RESULTS, ROOT, Record, read_table

import torchgrasp


def find_old(record: Record) -> list[str]:
    """Why a record may not hold for the present version; nothing where it does."""
    reasons = []
    version = record.versions.get("torchgrasp")
    if version != torchgrasp.__version__:
        reasons.append(f"version {version or 'not known'}, the present one is {torchgrasp.__version__}")
    if record.commit_is == "recorded":
        reasons.append(f"of {record.commit} or before")
    missing = [name for name in ("command", "machine") if getattr(record, name) == NOT_RECORDED]
    return reasons + [f"{name} {NOT_RECORDED}" for name in missing]


def find_behind(record: Record, since: str | None = None, root: Path = ROOT) -> list[str]:
    """Whether the history lacks a record's commit, or has it before the commit `since`."""
    if not is_in_history(record.commit, root=root):
        return [f"commit {record.commit} is not in this history"]
    if since is not None and not is_in_history(since, record.commit, root=root):
        return [f"of {record.commit}, which is without {since}"]
    return []


def tell_old(tables: Iterable[str], since: str | None = None, folder: Path = RESULTS) -> None:
    """Print a line for each record that may not hold any more, and why.

    Args:
        tables: their names.
        since: a commit, or a file or folder, for the last commit that changed it. Only records without
            that commit are told then, whatever their version.
        folder: of the tables.
    """
    commit = None if since is None else find_commit(since)
    total = old = 0
    for name in tables:
        for place, record in read_table(name, folder).records.items():
            total += 1
            reasons = find_behind(record, commit) + (find_old(record) if since is None else [])
            if reasons:
                old += 1
                print(f"{name}/{place}: {'; '.join(reasons)}")
    print(f"{old} of {total} records")
