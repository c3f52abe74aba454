"""Which results are of another version than the present one, and of which it is not known."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from result_tables import NOT_RECORDED, RESULTS, Record, read_table

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


def tell_old(tables: Iterable[str], folder: Path = RESULTS) -> None:
    """Print a line for each record that is not of the present version, or whose origin is not whole."""
    total = old = 0
    for name in tables:
        for place, record in read_table(name, folder).records.items():
            total += 1
            if reasons := find_old(record):
                old += 1
                print(f"{name}/{place}: {'; '.join(reasons)}")
    print(f"{old} of {total} records")
