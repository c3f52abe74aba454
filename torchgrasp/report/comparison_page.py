"""A comparison for readers and for programs: Markdown, CSV and one HTML file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from torchgrasp.data.files import write_text_atomically
from torchgrasp.errors import printable
from torchgrasp.evaluation.comparison import Difference, GroupRow, by_measure
from torchgrasp.evaluation.intervals import Interval
from torchgrasp.report.pages import render_page

_HEAD = ("", "seeds", "of each", "mean ± s.d.", "episodes", "pooled, 95 % interval")
_DIFFERENCE = ("", "difference to {first}", "95 % over seeds", "method", "95 % over episodes")
_COST = ("", "minutes", "env steps", "gradient steps")
_NOTES = (
    "Mean ± s.d.: over the runs, sample standard deviation. Pooled: all episodes of all runs together, with "
    "Wilson's interval.",
    "Over seeds: Student's t interval of the mean of the per-seed differences where both have the same seeds "
    "(paired), else Welch's (1947). It tells what training again would give on these scenes.",
    "Over episodes: Newcombe's hybrid score interval (1998, method 10) of the pooled rates. It takes every "
    "episode as independent and knows nothing of seeds: with few seeds, trust the wider one.",
)
_METHODS = {"paired": "paired by seed", "welch": "Welch", None: "one run: no interval"}


def write_comparison(folder: str | Path, rows: Sequence[GroupRow], *, title: str) -> list[Path]:
    """Write compare.md, compare.csv and compare.html, which holds all that it shows; returns their paths.

    Args:
        folder: an existing directory.
        rows: of `compare_runs`.
        title: heading of the page and of the Markdown.
    """
    texts = {
        "compare.md": to_markdown(rows, title=title),
        "compare.csv": to_csv(rows),
        "compare.html": to_page(rows, title=title),
    }
    for name, text in texts.items():
        write_text_atomically(Path(folder) / name, text)
    return [Path(folder) / name for name in texts]


def to_markdown(rows: Sequence[GroupRow], *, title: str) -> str:
    """Tables of every measure, and how the intervals are made."""
    parts = [f"# {title}"]
    for measure, group in by_measure(rows):
        parts += [f"## {measure}", _pipes(*_means(group)), _pipes(*_differences(group))]
    parts += ["## Cost of a run", _pipes(*_costs(rows)), *_NOTES]
    return "\n\n".join(part for part in parts if part) + "\n"


def to_text(rows: Sequence[GroupRow]) -> str:
    """The same tables for a terminal."""
    parts = []
    for measure, group in by_measure(rows):
        parts += [measure, _columns(*_means(group)), _columns(*_differences(group))]
    return "\n\n".join(part for part in [*parts, _columns(*_costs(rows))] if part)


def to_csv(rows: Sequence[GroupRow]) -> str:
    """A line for each measure of each group, numbers with all digits; lists have semicolons."""
    stream = io.StringIO()
    lines = [_csv_row(row) for row in rows]
    writer = csv.DictWriter(stream, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return stream.getvalue()


def to_page(rows: Sequence[GroupRow], *, title: str) -> str:
    """An HTML document that loads nothing."""
    return render_page(
        "comparison_page",
        title=title,
        measures=[_measure(*each) for each in by_measure(rows)],
        costs=_costs(rows),
        notes=_NOTES,
        runs=_runs(rows),
        scenes=rows[0].runs[0].scenes.items(),
    )


def _measure(name: str, group: list[GroupRow]) -> dict[str, Any]:
    """A measure's tables; a line comes with its group's pooled rate, None of all but success rates."""
    head, lines = _means(group)
    pooled = [row.pooled for row in group]
    return {
        "name": name,
        "head": (*head, "") if any(pooled) else head,
        "rows": list(zip(lines, pooled, strict=True)),
        "differences": _differences(group),
    }


Table = tuple[Sequence[object], list[tuple]]


def _means(group: list[GroupRow]) -> Table:
    """A line for each group; episodes and pooled rate of success alone."""
    success = group[0].success is not None
    head = _HEAD if success else _HEAD[:4]
    lines = []
    for row in group:
        seeds = ", ".join("?" if seed is None else str(seed) for seed in row.seeds)
        each = ", ".join(_number(_scale(row) * value, row) for value in row.values)
        pooled = (row.success[1], _pooled(row)) if row.success else ()
        lines.append((row.label, seeds, each, _spread(row), *pooled))
    return head, lines


def _differences(group: list[GroupRow]) -> Table:
    """A line for each group but the first."""
    head = [each.format(first=group[0].label) for each in _DIFFERENCE]
    lines = [_difference(row, row.difference) for row in group if row.difference is not None]
    if not group[0].success:
        head, lines = head[:-1], [line[:-1] for line in lines]
    return head, lines


def _difference(row: GroupRow, found: Difference) -> tuple:
    scale = _scale(row)
    over = _interval(row, found.over_seeds)
    return (
        row.label,
        f"{_number(scale * found.value, row, sign=True)}{' points' if row.success else ''}",
        over,
        _METHODS[found.method],
        _interval(row, found.over_episodes),
    )


def _costs(rows: Sequence[GroupRow]) -> Table:
    lines = []
    for row in next(iter(by_measure(rows)))[1]:
        steps = (f"{round(_mean(row, each)):,}" for each in ("env_steps", "gradient_steps"))
        lines.append((row.label, f"{_mean(row, 'wall_minutes'):.1f}", *steps))
    return _COST, lines


def _mean(row: GroupRow, name: str) -> float:
    return float(np.mean([getattr(run, name) for run in row.runs]))


def _runs(rows: Sequence[GroupRow]) -> Table:
    """Every run with its seed and its measures."""
    measures = dict(by_measure(rows))
    lines = []
    for first in next(iter(measures.values())):
        own = [row for group in measures.values() for row in group if row.label == first.label]
        for index, run in enumerate(first.runs):
            values = [f"{_number(_scale(row) * row.values[index], row)}{_unit(row)}" for row in own]
            seed = "" if run.seed is None else run.seed
            lines.append((first.label, seed, *values, f"{run.wall_minutes:.1f}", run.run))
    return ("", "seed", *measures, "minutes", "run"), lines


def _spread(row: GroupRow) -> str:
    scale = _scale(row)
    spread = "" if math.isnan(row.std) else f" ± {_number(scale * row.std, row)}"
    return f"{_number(scale * row.mean, row)}{spread}{_unit(row)}"


def _pooled(row: GroupRow) -> str:
    assert row.pooled is not None
    rate, low, high = (100 * each for each in row.pooled)
    return f"{rate:.1f} % [{low:.1f}, {high:.1f}]"


def _interval(row: GroupRow, bounds: Interval | None) -> str:
    if bounds is None:
        return "-"
    low, high = (_number(_scale(row) * bound, row, sign=True) for bound in bounds)
    return f"[{low}, {high}]"


def _scale(row: GroupRow) -> float:
    return 100.0 if row.success else 1.0


def _unit(row: GroupRow) -> str:
    return " %" if row.success else ""


def _number(value: float, row: GroupRow, *, sign: bool = False) -> str:
    return f"{value:{'+' if sign else ''}{'.1f' if row.success else '.4g'}}"


def _pipes(head: Sequence[object], lines: list[tuple]) -> str:
    """A Markdown table; empty where it has no lines."""
    marks = ["---"] * len(head)
    texts = [[_markdown(cell) for cell in line] for line in (head, marks, *lines)]
    return "\n".join(f"| {' | '.join(line)} |" for line in texts) if lines else ""


def _markdown(cell: object) -> str:
    """A cell as text alone: labels may hold signs of Markdown's tables or of HTML."""
    return printable(escape(str(cell), quote=False)).replace("|", "\\|")


def _columns(head: Sequence[object], lines: list[tuple]) -> str:
    """A table in columns as wide as their widest cell."""
    texts = [[printable(cell) for cell in line] for line in (head, *lines)]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    justify: Callable = lambda line: "  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True))  # noqa: E731
    return "\n".join(justify(line).rstrip() for line in texts) if lines else ""


def _csv_row(row: GroupRow) -> dict[str, object]:
    found = row.difference
    successes, episodes = row.success or ("", "")
    pooled, low, high = row.pooled or ("", "", "")
    return {
        "label": row.label,
        "measure": row.measure,
        "runs": ";".join(str(run.run) for run in row.runs),
        "seeds": ";".join("" if seed is None else str(seed) for seed in row.seeds),
        "values": ";".join(map(repr, row.values)),
        "mean": row.mean,
        "std": "" if math.isnan(row.std) else row.std,
        "successes": successes,
        "episodes": episodes,
        **{"pooled_rate": pooled, "pooled_low": low, "pooled_high": high},
        "difference": "" if found is None else found.value,
        "method": "" if found is None else found.method or "",
        **_bounds("seeds", found.over_seeds if found else None),
        **_bounds("episodes", found.over_episodes if found else None),
        **{name: _mean(row, name) for name in ("wall_minutes", "env_steps", "gradient_steps")},
    }


def _bounds(name: str, bounds: Interval | None) -> dict[str, object]:
    low, high = bounds or ("", "")
    return {f"difference_low_over_{name}": low, f"difference_high_over_{name}": high}
