"""The plot of suite=training: python docs/pictures/worker_plots.py <benchmark.json>.

Writes workers.png beside itself. Needs the extra viz.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchgrasp.report.plots import to_png

_FILE = Path(__file__).resolve().with_name("workers.png")
_NAMES = {"ProcessPool": "processes", "RayPool": "actors of Ray"}
_COLOURS = {"ProcessPool": "#1f6fb4", "RayPool": "#d1691c"}
_LINES = {False: {"linestyle": "-", "marker": "o"}, True: {"linestyle": "--", "marker": "s"}}
# Of a panel: what a row of the benchmark holds, and how it is called.
_PANELS = {
    "env_steps_per_second_of_both": "env steps/s",
    "learner_waits_seconds": "learner waits, s an iteration",
    "worker_waits_seconds": "a worker waits, s an iteration",
}


def plot_workers(result: dict[str, Any]) -> Figure:
    """Speed and who waits by the number of workers; a line for each collector, overlapping and not."""
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    panels = figure.subplots(1, len(_PANELS))
    for axes, (key, label) in zip(panels, _PANELS.items(), strict=True):
        _draw(axes, list(result["rows"].values()), key)
        _label(axes, label)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _draw(axes: Axes, rows: list[dict[str, Any]], key: str) -> None:
    """A line for each way to collect, and one across for a single process."""
    for alone in (row for row in rows if row["workers"] == 0):
        axes.axhline(alone[key], color="grey", linestyle=":", linewidth=1.3, label="one process")
    for collector, name in _NAMES.items():
        for overlap, line in _LINES.items():
            chosen = [
                row
                for row in rows
                if row["workers"] and row["collector"] == collector and row["overlap"] == overlap
            ]
            if chosen:
                chosen.sort(key=lambda row: row["workers"])
                style: dict[str, Any] = {"color": _COLOURS[collector], "linewidth": 1.3, "markersize": 3}
                label = name + (", overlapping" if overlap else "")
                x, y = [row["workers"] for row in chosen], [row[key] for row in chosen]
                axes.plot(x, y, label=label, **style, **line)


def _label(axes: Axes, label: str) -> None:
    """Numbers of workers as ticks, doubling from one to the next; figures begin at zero."""
    axes.set_xscale("log", base=2)
    axes.set_ylim(bottom=0.0)
    lines = [line for line in axes.lines if line.get_marker() not in (None, "None", "")]
    counts = sorted({float(x) for line in lines for x in line.get_xdata()})  # pyright: ignore
    axes.set_xticks(counts, [f"{count:g}" for count in counts])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("workers", fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    _FILE.write_bytes(to_png(plot_workers(json.loads(Path(sys.argv[1]).read_text()))))
    print(f"Written to {_FILE}")
