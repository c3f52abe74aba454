"""Pictures of the documentation are shown, with words for who does not see them; plots show their figures."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from torchgrasp.report.plots import can_plot

_ROOT = Path(__file__).parents[2]
_PICTURES = _ROOT / "docs" / "pictures"
_SHOWN = re.compile(r"!\[([^\]]*)\]\([^)]*?pictures/([^)]+)\)")


def test_every_picture_is_shown_with_words():
    pages = [_ROOT / "README.md", *(_ROOT / "docs").rglob("*.md")]
    words = {file: told for page in pages for told, file in _SHOWN.findall(page.read_text())}
    pictures = {path.name for path in _PICTURES.iterdir() if path.suffix in (".png", ".jpg", ".webp")}
    assert words.keys() == pictures
    assert all(len(told.split()) > 3 for told in words.values())


def load_maker(name: str) -> ModuleType:
    """A script beside the pictures."""
    spec = importlib.util.spec_from_file_location(name, _PICTURES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(not can_plot(), reason="needs the extra viz")
def test_plots_of_scale_show_the_figures_of_each_machine():
    module = load_maker("scale_plots")
    sizes = {"batch": (32, 64), "points": (128, 256)}
    rows = [
        {"over": over, "what": "critic", "device": "cuda", over: size, "milliseconds": size, "megabytes": 1.0}
        for over, both in sizes.items()
        for size in both
    ]
    rollouts = {"over": "workers", "what": "rollouts", "device": "cpu", "workers": 1}
    rows.append({**rollouts, "env_steps_per_second": 140.0, "megabytes": 500.0})
    hardware = {"cores": 16, "accelerators": ["NVIDIA H100 80GB HBM3"]}
    figure = module.plot_scale([{"rows": rows, "hardware": hardware}])
    milliseconds, _, speed = figure.axes[:3]
    assert milliseconds.lines[0].get_xydata().tolist() == [[32, 32], [64, 64]]
    assert speed.lines[0].get_xydata().tolist() == [[1, 140]]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["critic, H100", "rollouts, 16-core CPU"]


@pytest.mark.skipif(not can_plot(), reason="needs the extra viz")
def test_plots_of_workers_show_each_way_to_collect():
    figures = {"learner_waits_seconds": 2.0, "worker_waits_seconds": 7.0}

    def row(collector: str, workers: int, overlap: bool, speed: float) -> dict:
        told = {"collector": collector, "workers": workers, "overlap": overlap, **figures}
        return told | {"env_steps_per_second_of_both": speed}

    rows = [row("SerialPool", 0, False, 41.0)]
    rows += [row("RayPool", count, overlap, 10.0 * count + overlap) for count in (8, 1) for overlap in (0, 1)]
    figure = load_maker("worker_plots").plot_workers({"rows": dict(enumerate(rows))})
    speed = figure.axes[0]
    assert [line.get_xydata().tolist() for line in speed.lines[1:]] == [
        [[1, 10], [8, 80]],
        [[1, 11], [8, 81]],
    ]
    (legend,) = figure.legends
    told = [text.get_text() for text in legend.get_texts()]
    assert told == ["one process", "actors of Ray", "actors of Ray, overlapping"]
