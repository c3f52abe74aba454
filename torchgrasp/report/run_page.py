"""A run as one HTML file: success, objects, failures, grasp prediction, curves, pictures, configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchgrasp.data.files import write_text_atomically
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.learning_curves import LearningCurve, read_metrics
from torchgrasp.evaluation.run_results import flatten
from torchgrasp.report.pages import render_page
from torchgrasp.report.plots import can_plot, plot_curves, to_svg

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


class _Figure(NamedTuple):
    """A picture's file, png or svg+xml; `words` stand below it, or instead of it alone."""

    content: bytes
    words: str
    kind: str = "png"
    captioned: bool = True


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
    networks = summary.get("grasp_prediction", {})
    text = render_page(
        "run_page",
        title=title,
        facts=[*_facts(summary), *(highlights or {}).items()],
        tables=tables,
        learner_steps=_in_order(summary.get("learner_steps", {})),
        failures=summary.get("failures", {}),
        lifted=sum(row["successes"] > 0 for row in summary["objects"].values()),
        met=len(summary["objects"]),
        predictions=_predictions(networks),
        trajectories=next((errors["trajectories"] for errors in networks.values()), 0),
        galleries={**_curves(Path(run_dir)), **_galleries(pictures or {})},
        can_plot=can_plot(),
        objects=_objects(tables),
        versions=summary.get("versions", {}),
        hardware=summary.get("hardware", {}),
        options=flatten(config or {}),
    )
    path = Path(run_dir) / "report.html"
    write_text_atomically(path, text)
    return path


def _facts(summary: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    for name in ("protocol", "scenes", "learner", "episodes", "env_steps", "gradient_steps"):
        if summary.get(name):  # an evaluation has no gradient steps to tell of
            value = summary[name]
            yield name.replace("_", " "), f"{value:,}" if isinstance(value, int) else value
    if "wall_seconds" in summary:
        yield "wall time", f"{summary['wall_seconds'] / 60:.1f} minutes"


def _in_order(groups: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Rows of policy=takeover, named `0-5`, `6-10`, ..., by the learner's steps."""
    return dict(sorted(groups.items(), key=lambda item: int(item[0].split("-")[0])))


def _predictions(networks: Mapping[str, Mapping[str, Any]]) -> list[tuple]:
    """(network, what it is measured against, errors by measure), a line each."""
    return [
        (network, words, errors[reading])
        for network, errors in networks.items()
        for reading, words in _READINGS.items()
        if reading in errors
    ]


def _curves(run_dir: Path) -> dict[str, list[_Figure]]:
    """One small picture for each column of metrics.csv that has at least two values, success first."""
    if not (run_dir / "metrics.csv").is_file():
        return {}
    if not can_plot():
        return {"Curves": []}
    columns = read_metrics(run_dir)
    step = columns.pop("step")
    names = sorted(columns.keys() - {"env_steps"}, key=lambda name: ("success" not in name, name))
    drawn = [name for name in names if np.isfinite(columns[name]).sum() > 1]
    return {"Curves": [_curve(name, step, columns[name]) for name in drawn]}


def _curve(name: str, step: np.ndarray, values: np.ndarray) -> _Figure:
    there = np.flatnonzero(np.isfinite(values))
    there = there[np.unique(np.linspace(0, len(there) - 1, _MAX_POINTS).round().astype(int))]
    curve = LearningCurve(step[there], values[there], np.full(len(there), np.nan), 1)
    figure = plot_curves({name: curve}, x="gradient step", y=name, size=(3.8, 2.5))
    return _Figure(to_svg(figure).encode(), name, kind="svg+xml", captioned=False)


def _galleries(pictures: Mapping[str, Sequence[Picture]]) -> dict[str, list[_Figure]]:
    return {
        heading: [_Figure(each.png, each.caption) for each in shown] for heading, shown in pictures.items()
    }


def _objects(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any] | None]]:
    """By object each table's row, None where a policy never met the object."""
    names = sorted({name for table in tables.values() for name in table["objects"]})
    return {name: [table["objects"].get(name) for table in tables.values()] for name in names}
