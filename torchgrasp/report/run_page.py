"""A run as one HTML file: success, objects, failures, grasp prediction, curves, pictures, configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchgrasp.data.files import write_text_atomically
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.learning_curves import LearningCurve, read_metrics
from torchgrasp.evaluation.run_results import flatten
from torchgrasp.report.html import (
    Markup,
    draw_interval,
    make_figure,
    make_gallery,
    make_note,
    make_page,
    make_section,
    make_table,
)
from torchgrasp.report.plots import can_plot, plot_curves, to_svg

_NO_PICTURES = 'No pictures: they need the extra viz, pip install "torchgrasp[viz]".'
_MAX_POINTS = 400  # of a curve; more only make the file large
_READINGS = {
    "expert_goal": "the expert's goal",
    "expert_goal_or_half_turn": "the same, or its half turn",
    "nearest_known_grasp": "the nearest known grasp",
}


@dataclass(frozen=True)
class Picture:
    """A PNG file's bytes and what it shows."""

    png: bytes
    caption: str


def write_report(
    run_dir: str | Path,
    summary: Mapping[str, Any],
    *,
    title: str,
    highlights: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
    pictures: Mapping[str, Sequence[Picture]] | None = None,
) -> Path:
    """Write `<run_dir>/report.html`, which holds all that it shows and loads nothing; returns its path.

    Curves are drawn from metrics.csv in the same directory, where there is one and matplotlib is installed.

    Args:
        run_dir: of a training or an evaluation.
        summary: what `write_summary` returns. With `comparison` {name: table} all tables stand side by
            side, otherwise the summary's own under the name `policy`.
        title: of the page.
        highlights: what of the configuration a reader wants first, by name.
        config: the whole configuration, nested; it is folded away.
        pictures: by the heading that they stand under.
    """
    for key in ("success_rate", "success_ci95", "objects"):
        if key not in summary:
            raise ConfigError(f"The summary of a report lacks {key!r}: give what write_summary returns.")
    tables = summary.get("comparison") or {str(summary.get("policy", "policy")): summary}
    sections = [
        make_table((), _facts(summary, highlights or {})),
        make_section("Success", _success(tables), _grouped(summary)),
        *_failures(summary),
        *_predictions(summary.get("grasp_prediction", {})),
        *_curves(Path(run_dir)),
        *_galleries(pictures or {}),
        make_section("Objects", _objects(tables)),
        *_origin(summary, config or {}),
    ]
    path = Path(run_dir) / "report.html"
    write_text_atomically(path, make_page(title, sections))
    return path


def _facts(summary: Mapping[str, Any], highlights: Mapping[str, Any]) -> Iterator[tuple]:
    names = ("protocol", "scenes", "learner", "episodes", "env_steps", "gradient_steps")
    for name in names:
        if summary.get(name):  # an evaluation has no gradient steps to tell of
            value = summary[name]
            yield name.replace("_", " "), f"{value:,}" if isinstance(value, int) else value
    if "wall_seconds" in summary:
        yield "wall time", f"{summary['wall_seconds'] / 60:.1f} minutes"
    yield from highlights.items()


def _success(tables: Mapping[str, Mapping[str, Any]]) -> Markup:
    rows = [(name, table["episodes"], *_rate(table)) for name, table in tables.items()]
    return make_table(("policy", "episodes", "success", "95 % interval", ""), rows)


def _rate(row: Mapping[str, Any]) -> tuple[str, str, Markup]:
    rate, (low, high) = row["success_rate"], row["success_ci95"]
    return f"{100 * rate:.1f} %", f"{100 * low:.1f} to {100 * high:.1f}", draw_interval(rate, low, high)


def _grouped(summary: Mapping[str, Any]) -> Markup:
    """For policy=takeover success by the learner's steps."""
    groups = summary.get("learner_steps", {})
    ordered = sorted(groups.items(), key=lambda item: int(item[0].split("-")[0]))
    rows = [(name, row["episodes"], *_rate(row)) for name, row in ordered]
    head = ("the learner's steps", "episodes", "success", "95 % interval", "")
    return make_table(head, rows) if rows else Markup()


def _failures(summary: Mapping[str, Any]) -> Iterator[Markup]:
    failures = summary.get("failures", {})
    if failures:
        total = sum(failures.values())
        rows = [(cause, count, f"{100 * count / total:.0f} %") for cause, count in failures.items()]
        table = make_table(("cause", "episodes", "of the failures"), rows)
        yield make_section("Failures", table, make_note(_lifted(summary)))


def _lifted(summary: Mapping[str, Any]) -> str:
    met = len(summary["objects"])
    lifted = sum(row["successes"] > 0 for row in summary["objects"].values())
    return f"{lifted} of the {met} objects met were lifted at least once."


def _predictions(networks: Mapping[str, Mapping[str, Any]]) -> Iterator[Markup]:
    rows = [
        (network, words, *_prediction_cells(errors[reading]))
        for network, errors in networks.items()
        for reading, words in _READINGS.items()
        if reading in errors
    ]
    if rows:
        head = ("network", "against", "translation (m)", "rotation (°)", "point distance (m)")
        count = next(iter(networks.values()))["trajectories"]
        words = f"Least / mean error along a trajectory of the expert, averaged over {count} of them. "
        words += "The least are reached where the hand has arrived: compare the means."
        yield make_section("Grasp prediction", make_table(head, rows), make_note(words))


def _prediction_cells(row: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    for measure, digits in (("translation_m", 3), ("rotation_deg", 1), ("point_distance_m", 3)):
        yield f"{row[measure]['min']:.{digits}f} / {row[measure]['mean']:.{digits}f}"


def _curves(run_dir: Path) -> Iterator[Markup]:
    """One small picture for each column of metrics.csv that has at least two values."""
    if not (run_dir / "metrics.csv").is_file():
        return
    if not can_plot():
        yield make_section("Curves", make_note(_NO_PICTURES))
        return
    columns = read_metrics(run_dir)
    step = columns.pop("step")
    names = sorted(
        columns.keys() - {"env_steps"}, key=lambda name: ("success" not in name, name)
    )  # success first
    figures = [_curve(name, step, columns[name]) for name in names if np.isfinite(columns[name]).sum() > 1]
    if figures:
        yield make_section("Curves", make_gallery(figures))


def _curve(name: str, step: np.ndarray, values: np.ndarray) -> Markup:
    there = np.flatnonzero(np.isfinite(values))
    there = there[np.unique(np.linspace(0, len(there) - 1, _MAX_POINTS).round().astype(int))]
    curve = LearningCurve(step[there], values[there], np.full(len(there), np.nan), 1)
    figure = plot_curves({name: curve}, x="gradient step", y=name, size=(3.8, 2.5))
    return make_figure(to_svg(figure).encode(), name, kind="svg+xml", caption=False)


def _galleries(pictures: Mapping[str, Sequence[Picture]]) -> Iterator[Markup]:
    for heading, shown in pictures.items():
        if shown:
            figures = (make_figure(picture.png, picture.caption) for picture in shown)
            yield make_section(heading, make_gallery(figures))
        elif not can_plot():
            yield make_section(heading, make_note(_NO_PICTURES))


def _objects(tables: Mapping[str, Mapping[str, Any]]) -> Markup:
    """As Table 6: successes of each policy on every object, and why the first one failed."""
    first = next(iter(tables.values()))["objects"]
    names = sorted({name for table in tables.values() for name in table["objects"]})
    rows = []
    for name in names:
        own = first.get(name)
        causes = "; ".join(f"{n} {cause}" for cause, n in (own or {}).get("failures", {}).items())
        cells = [_count(table["objects"].get(name)) for table in tables.values()]
        rate = _rate(own)[1:] if own else ("", "")
        rows.append((name, *cells, *rate, causes))
    whose = f" of {next(iter(tables))}" if len(tables) > 1 else ""
    head = ("object", *tables, f"95 % interval{whose}", "", f"failures{whose}")
    return make_table(head, rows)


def _count(row: Mapping[str, Any] | None) -> str:
    return f"{row['successes']} of {row['episodes']}" if row else ""


def _origin(summary: Mapping[str, Any], config: Mapping[str, Any]) -> Iterator[Markup]:
    yield Markup("<h2>Configuration</h2>")
    yield make_section("versions", make_table((), summary.get("versions", {}).items()), closed=True)
    yield make_section("hardware", make_table((), summary.get("hardware", {}).items()), closed=True)
    yield make_section("all options", make_table((), flatten(config)), closed=True)
