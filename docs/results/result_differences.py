"""Differences between rows of a planned table, by the library's own statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from result_plans import Plan, planned_row
from result_records import Record

from torchgrasp.documents import Document, Name
from torchgrasp.evaluation.comparison import compare_runs
from torchgrasp.evaluation.run_results import RunResult
from torchgrasp.evaluation.success import find_gain


class Pair(Document):
    """An order of the paper: one row is expected to be better than another.

    Attributes:
        order: what the paper found.
        better: the row that should be better, as "run", or "run#1" for the run's second row.
        worse: the other one.
        published: rows whose published rates give the paper's difference, where these two have none.
    """

    order: Name
    better: Name
    worse: Name
    published: Annotated[list[Name], Field(min_length=2, max_length=2)] | None = None


class Pairs(Document):
    """The pairs of rows that a table compares, and the planned table that has these rows."""

    table: Name
    pairs: Annotated[list[Pair], Field(min_length=1)]


def difference_rows(pairs: Pairs, plan: Plan, records: Mapping[str, Record]) -> list[dict[str, Any]]:
    """A row for each pair: `points`, its intervals, the paper's `published` points, and what holds `here`."""
    rows = []
    for pair in pairs.pairs:
        better, worse = (planned_row(plan, name, records) for name in (pair.better, pair.worse))
        told = [planned_row(plan, name, records) for name in pair.published or (pair.better, pair.worse)]
        published = [each["published"] for each in told if "published" in each]
        row: dict[str, Any] = {"order": pair.order}
        if len(published) == 2:
            row["published"] = [_minus(*rates) for rates in zip(*published, strict=True)]
        rows.append(row | _difference(better, worse))
    return rows


def tell_order(intervals: Sequence[Sequence[float]]) -> str:
    """What 95 % intervals of "better minus worse" say of the order.

    >>> tell_order([(1.0, 3.0), (0.5, 4.0)]), tell_order([(1.0, 3.0), (-1.0, 4.0)])
    ('holds', 'holds by one interval of two')
    >>> tell_order([(-3.0, -1.0), (-4.0, -0.5)]), tell_order([(-1.0, 2.0), (-2.0, 3.0)])
    ('the other way round', 'not told apart')
    """
    above, below = sum(low > 0 for low, _ in intervals), sum(high < 0 for _, high in intervals)
    if above == below:
        return "not told apart"
    words, count = ("holds", above) if above > below else ("the other way round", below)
    return words if count == len(intervals) else f"{words} by one interval of two"


def _difference(better: Mapping[str, Any], worse: Mapping[str, Any]) -> dict[str, Any]:
    """Nothing where the two are not of the same version and seeds: their scenes may differ."""
    alike = all(better.get(name) == worse.get(name) for name in ("version", "seeds", "episodes"))
    if not alike or len(better.get("seeds", ())) < 2:
        return {}
    found = compare_runs({"worse": _results(worse), "better": _results(better)})[1].difference
    assert found is not None and found.over_seeds is not None and found.over_episodes is not None
    paired = _paired(better, worse)
    intervals = [[100 * end for end in each] for each in (found.over_seeds, paired or found.over_episodes)]
    return {
        "points": 100 * found.value,
        "over_seeds": intervals[0],
        "over_episodes": intervals[1],
        "method": "paired" if paired else "Newcombe",
        "here": tell_order(intervals),
    }


def _paired(better: Mapping[str, Any], worse: Mapping[str, Any]) -> list[float] | None:
    """Over the scenes of all seeds, paired by scene and seed; None where it is not known how each ended."""
    if "outcomes" not in better or "outcomes" not in worse:
        return None
    tables = [{"success_rate": 0.0, "outcomes": "".join(each["outcomes"])} for each in (better, worse)]
    return find_gain(*tables)["ci95"]


def _results(row: Mapping[str, Any]) -> list[RunResult]:
    found = zip(row["seeds"], row["success_rate"], row["episodes"], strict=True)
    return [
        RunResult(Path(f"seed {seed}"), seed, {"success rate": rate}, (round(rate * n), n), {}, 0.0, 0, 0)
        for seed, rate, n in found
    ]


def _minus(rate: float | None, other: float | None) -> float | None:
    """In points; None where either is not known."""
    return None if rate is None or other is None else 100 * (rate - other)
