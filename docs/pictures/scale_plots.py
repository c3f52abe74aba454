"""The plots of suite=scale: python docs/pictures/scale_plots.py <benchmark.json> [<that of another machine>].

Writes scale.png beside itself. Needs the extra viz.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchgrasp.report.plots import to_png

_FILE = Path(__file__).resolve().with_name("scale.png")
_COLOURS = {"imitation": "#1f6fb4", "critic": "#d1691c", "actor": "#2f8f4e", "rollouts": "#6a55a8"}
_STYLES = ({"linestyle": "-", "marker": "o"}, {"linestyle": "--", "marker": "s"})  # by file
_SIZES = {"batch": "transitions a batch", "points": "points a cloud", "workers": "workers"}
_TIME, _SPEED = ("milliseconds", "ms an update"), ("env_steps_per_second", "env steps/s")
_MEMORY = ("megabytes", "MB")


def plot_scale(results: Sequence[dict[str, Any]]) -> Figure:
    """Panels of time above memory, by batch, points and workers; a line style for each result."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    panels = figure.subplots(2, len(_SIZES))
    for column, over in zip(panels.T, _SIZES, strict=True):
        figures = (_SPEED if over == "workers" else _TIME, _MEMORY)
        for axes, (key, label) in zip(column, figures, strict=True):
            for result, style in zip(results, _STYLES, strict=False):
                _draw(axes, result, over, key, style)
            _label(axes, over, label)
    handles = dict(zip(*reversed(panels[0, 0].get_legend_handles_labels()), strict=True))
    handles |= dict(zip(*reversed(panels[0, 2].get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _draw(axes: Axes, result: dict[str, Any], over: str, key: str, style: dict[str, str]) -> None:
    """A line for each kind of update, or that of the rollouts."""
    for what, colour in _COLOURS.items():
        rows = [row for row in result["rows"] if row["over"] == over and row["what"] == what]
        if rows:
            rows.sort(key=lambda row: row[over])
            line: dict[str, Any] = {"color": colour, "linewidth": 1.3, "markersize": 3, **style}
            label = f"{what}, {_machine(result, rows[0]['device'])}"
            axes.plot([row[over] for row in rows], [row[key] for row in rows], label=label, **line)


def _machine(result: dict[str, Any], device: str) -> str:
    """What computed: a GPU's name, or the cores."""
    hardware = result["hardware"]
    if device.startswith("cuda"):
        return hardware["accelerators"][0].removeprefix("NVIDIA ").split()[0]
    return f"{hardware['cores']}-core CPU"


def _label(axes: Axes, over: str, label: str) -> None:
    """Sizes that were measured as ticks; updates double from line to line, rollouts begin at zero."""
    if over == "workers":
        axes.set_ylim(bottom=0.0)
    else:
        axes.set_xscale("log", base=2)
        axes.set_yscale("log", base=2)
    sizes = sorted({float(x) for line in axes.lines for x in line.get_xdata()})  # pyright: ignore
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel(_SIZES[over], fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    _FILE.write_bytes(to_png(plot_scale([json.loads(Path(name).read_text()) for name in sys.argv[1:3]])))
    print(f"Written to {_FILE}")
