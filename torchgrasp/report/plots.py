"""Figures through matplotlib, of the extra `viz`: curves with their spread, predicted grasps."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from torchgrasp.errors import ConfigError, printable
from torchgrasp.evaluation.learning_curves import LearningCurve
from torchgrasp.geometry import gripper_control_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Control points of X_g joined to a fork: tip, base, base, tip; and palm to the bases' middle.
_FORK = (4, 2, 3, 5)
_HANDS = (("#d02020", 1.6), ("#2f8f4e", 3.2), ("#9cc4ea", 5.5))  # colour, width in points
_COLOURS = ("#1f6fb4", "#d1691c", "#2f8f4e", "#a33a6a", "#6a55a8", "#7a6a52", "#3aa0a6", "#888888")


def can_plot() -> bool:
    """Whether matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True


def check_plot_tools() -> None:
    """Raise ConfigError where matplotlib is not installed."""
    if not can_plot():
        raise ConfigError('Figures need the extra viz: pip install "torchgrasp[viz]".')


def plot_curves(
    curves: Mapping[str, LearningCurve], *, x: str, y: str, size: tuple[float, float] = (7.0, 4.2)
) -> Figure:
    """Every curve's mean as a line, one standard deviation to either side shaded; `size` in inches.

    Where `y` is a success rate, the axis shows all of [0, 1].
    """
    figure = _figure(size)
    axes = figure.subplots()
    for number, (label, curve) in enumerate(curves.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        dot = "o" if len(curve.x) == 1 else None
        words = _as_text(f"{label} ({curve.runs} runs)" if curve.runs > 1 else label)
        axes.plot(curve.x, curve.mean, color=colour, label=words, linewidth=1.4, marker=dot)
        if curve.runs > 1:
            low, high = curve.mean - curve.std, curve.mean + curve.std
            axes.fill_between(curve.x, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set_xlabel(_as_text(x))
    axes.set_ylabel(_as_text(y))
    if y.endswith("success_rate"):
        axes.set_ylim(-0.02, 1.02)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    if len(curves) > 1 or any(curve.runs > 1 for curve in curves.values()):
        axes.legend(frameon=False)
    return figure


def _as_text(words: str) -> str:
    """Words as matplotlib shows them letter by letter: between dollars it would read a formula."""
    return printable(words).replace("$", r"\$")


def plot_grasps(
    points: NDArray, hands: Mapping[str, NDArray], *, size: tuple[float, float] = (3.4, 3.4)
) -> Figure:
    """A cloud (N, 3) and hand poses (4, 4) by name, drawn as forks, in one frame, metres (Fig. 8).

    At most three hands; the first is drawn thin on top of the others, so that equal ones all show.
    """
    figure = _figure(size)
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.scatter(*points.T, s=2, c="#b0a48a", depthshade=True)
    drawn = [points]
    for (colour, width), (name, pose) in zip(_HANDS, hands.items(), strict=False):
        hand = gripper_control_points().numpy() @ pose[:3, :3].T + pose[:3, 3]
        stem = np.stack((hand[0], (hand[2] + hand[3]) / 2))
        line: dict = {"color": colour, "linewidth": width, "zorder": 20 - width}
        axes.plot(*hand[list(_FORK)].T, label=name, **line)
        axes.plot(*stem.T, **line)
        drawn.append(hand)
    _same_scale(axes, np.concatenate(drawn))
    axes.set_axis_off()
    figure.legend(loc="outside lower center", ncols=len(hands), fontsize=7, frameon=False)
    return figure


def _same_scale(axes: Any, drawn: NDArray) -> None:
    """A cube around all that is drawn: a metre is a metre along every axis."""
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    middle, half = (low + high) / 2, (high - low).max() / 2 + 1e-3
    for name, centre in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{name}lim")(centre - half, centre + half)
    axes.set_box_aspect((1, 1, 1), zoom=1.2)


def to_svg(figure: Figure) -> str:
    """The figure as an <svg> element to stand in a page; its text is drawn, so that it needs no font."""
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": "torchgrasp"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def to_png(figure: Figure, *, dpi: int = 130) -> bytes:
    """The figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


def _figure(size: tuple[float, float]) -> Figure:
    # A Figure of its own, not pyplot's: no window system, no state shared with the user's figures.
    check_plot_tools()
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained")
