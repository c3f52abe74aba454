import base64
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.learning_curves import LearningCurve
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.geometry import gripper_control_points
from torchgrasp.report.drawing import observed_points
from torchgrasp.report.plots import plot_curves, plot_grasps, to_png, to_svg
from torchgrasp.report.run_page import Picture, write_report

ERRORS = {"translation_m": (0.02, 0.047), "rotation_deg": (7.61, 19.465), "point_distance_m": (0.028, 0.069)}
VOID = {"meta", "img", "line", "circle"}


class Page(HTMLParser):
    """What a page shows and what it loads; fails on tags that do not close in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.sources: list[str] = []
        self.headings: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href", "data")]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag, attrs):
        assert tag in VOID

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data
        elif self.open and self.open[-1] == "h2":
            self.headings.append(data)


def make_summary(outcomes: str = "110") -> dict:
    table = SuccessTable()
    for name, outcome in zip(("mug", "bowl", "bowl"), outcomes, strict=True):
        table.add(name, outcome == "1", cause=None if outcome == "1" else "slipped")
    return {**table.summary(), "wall_seconds": 90.0, "env_steps": 1234567, "versions": {"torch": "2.13"}}


def read(path) -> Page:
    return Page(path.read_text())


def test_tables_hold_the_summarys_numbers(tmp_path):
    page = read(write_report(tmp_path, make_summary(), title="A run"))
    assert ["env steps", "1,234,567"] in page.rows
    assert ["wall time", "1.5 minutes"] in page.rows
    # Wilson's interval of 2 of 3, by hand.
    assert ["policy", "3", "66.7 %", "20.8 to 93.9", ""] in page.rows
    assert ["slipped", "1", "100 %"] in page.rows
    assert ["bowl", "1 of 2", "9.5 to 90.5", "", "1 slipped"] in page.rows
    assert ["mug", "1 of 1", "20.7 to 100.0", "", ""] in page.rows
    assert ["torch", "2.13"] in page.rows


def test_policies_stand_side_by_side(tmp_path):
    tables = {"policy": make_summary("110"), "expert": make_summary("111")}
    page = read(write_report(tmp_path, {**tables["policy"], "comparison": tables}, title="A run"))
    assert [row[:3] for row in page.rows if row[0] == "expert"] == [["expert", "3", "100.0 %"]]
    head = ["object", "policy", "expert", "95 % interval of policy", "", "failures of policy"]
    assert head in page.rows
    assert ["bowl", "1 of 2", "2 of 2", "9.5 to 90.5", "", "1 slipped"] in page.rows


def test_takeovers_stand_by_the_learners_steps_in_order(tmp_path):
    rows = make_summary()["objects"]
    summary = {**make_summary(), "learner_steps": {"11-15": rows["bowl"], "0-5": rows["mug"]}}
    page = read(write_report(tmp_path, summary, title="A run"))
    assert [row[:3] for row in page.rows if row[0] in ("0-5", "11-15")] == [
        ["0-5", "1", "100.0 %"],
        ["11-15", "2", "50.0 %"],
    ]


def test_a_loss_that_diverged_still_has_its_curve(tmp_path):
    (tmp_path / "metrics.csv").write_text("step,loss\n0,1\n5,0.5\n9,nan\n12,inf\n")
    assert len(read(write_report(tmp_path, make_summary(), title="A run")).sources) == 1


def test_grasp_prediction_is_table_5(tmp_path):
    row = {name: {"min": least, "mean": mean} for name, (least, mean) in ERRORS.items()}
    summary = {**make_summary(), "grasp_prediction": {"actor": {"trajectories": 7, "expert_goal": row}}}
    page = read(write_report(tmp_path, summary, title="A run"))
    cells = ["actor", "the expert's goal", "0.020 / 0.047", "7.6 / 19.5", "0.028 / 0.069"]
    assert cells in page.rows


def test_nothing_is_loaded_from_elsewhere(tmp_path):
    (tmp_path / "metrics.csv").write_text("step,loss,once\n0,1,\n5,0.5,3\n9,,\n")
    picture = Picture(to_png(plot_grasps(np.zeros((1, 3)), {"predicted": np.eye(4)})), "a mug")
    page = read(write_report(tmp_path, make_summary(), title="A run", pictures={"Grasps": [picture]}))
    kinds = sorted(source.split(";")[0] for source in page.sources)
    assert kinds == ["data:image/png", "data:image/svg+xml"]  # `once` has one value: no curve
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert base64.b64decode(page.sources[-1].split(",")[1])[:4] == b"\x89PNG"


def test_text_of_the_run_is_not_markup(tmp_path):
    summary = {**make_summary(), "policy": "<script>alert(1)</script>"}
    options = {"objects": {"path": "a<b>&c\u202e\x1b\udce9", "empty": {}}, "transforms": [1, 2]}
    page = read(write_report(tmp_path, summary, title="<b>", config=options))
    assert "script" not in page.tags and "b" not in page.tags
    assert ["objects.path", "a<b>&c\\u202e\\x1b\\udce9"] in page.rows and ["objects.empty", "{}"] in page.rows


def test_without_matplotlib_tables_remain_and_a_line_says_why(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    (tmp_path / "metrics.csv").write_text("step,loss\n0,1\n5,0.5\n")
    path = write_report(tmp_path, make_summary(), title="A run", pictures={"Failed episodes": []})
    page = read(path)
    assert page.headings == ["Success", "Failures", "Curves", "Failed episodes", "Objects", "Configuration"]
    assert not page.sources and path.read_text().count("extra viz") == 2
    with pytest.raises(ConfigError, match="extra viz"):
        plot_curves({}, x="step", y="")


def test_a_summary_without_success_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="'success_rate'"):
        write_report(tmp_path, {"objects": {}}, title="A run")


def test_an_interval_is_drawn_on_a_scale_from_0_to_1(tmp_path):
    row = {"episodes": 4, "successes": 2, "success_rate": 0.5, "success_ci95": [0.0, 1.0]}
    text = write_report(tmp_path, {**row, "objects": {"mug": row}}, title="A run").read_text()
    assert len(re.findall(r'x1="6\.0" x2="134\.0" .*\n<circle cx="70\.0"', text)) == 2


def test_an_object_that_the_first_policy_never_met_has_empty_cells(tmp_path):
    tables = {"policy": make_summary("110"), "expert": make_summary("111")}
    del tables["policy"]["objects"]["mug"]
    page = read(write_report(tmp_path, {**tables["policy"], "comparison": tables}, title="A run"))
    assert ["mug", "", "1 of 1", "", "", ""] in page.rows


def test_a_curve_is_shaded_only_where_there_is_a_spread():
    x, y = np.array([0.0, 1.0]), np.array([0.2, 0.8])
    several = LearningCurve(x, y, np.array([0.1, 0.2]), 3)
    alone = LearningCurve(x, y, np.full(2, np.nan), 1)
    (axes,) = plot_curves({"several": several, "alone": alone}, x="steps", y="rate").axes
    assert [line.get_ydata().tolist() for line in axes.lines] == [[0.2, 0.8], [0.2, 0.8]]
    (shade,) = axes.collections
    low, high = shade.get_paths()[0].get_extents().intervaly
    assert (low, high) == pytest.approx((0.1, 1.0))


def test_labels_are_no_formulas():
    curve = LearningCurve(np.arange(2.0), np.arange(2.0), np.full(2, np.nan), 1)
    labels = ("$\\nosuch$", "costs $5", "a\x1b[2Jb")
    figure = plot_curves(dict.fromkeys(labels, curve), x="$\\x$", y="$y_{")
    shown = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]  # pyright: ignore
    assert shown == [r"\$\nosuch\$", r"costs \$5", r"a\x1b[2Jb"]
    assert to_svg(figure).startswith("<svg")


def test_a_figure_is_the_same_every_time():
    x = np.array([0.0, 1.0])
    curves = {"one": LearningCurve(x, x, x, 2)}
    assert to_svg(plot_curves(curves, x="a", y="b")) == to_svg(plot_curves(curves, x="a", y="b"))


def test_a_grasp_is_drawn_where_the_hand_is():
    pose = np.eye(4)
    pose[:3, 3] = [0.5, -0.1, 0.3]
    (axes,) = plot_grasps(np.zeros((2, 3)), {"predicted": pose}).axes
    fork = np.stack(axes.lines[0].get_data_3d(), axis=-1)
    tips = gripper_control_points().numpy()[4:] + pose[:3, 3]
    np.testing.assert_allclose(fork[[0, -1]], tips, atol=1e-6)


def test_gripper_points_and_empty_rows_are_not_observed():
    cloud = np.array([[0.1, 0.2, 0.3, 0], [0, 0, 0, 0], [0.4, 0.5, 0.6, 1]])
    np.testing.assert_array_equal(observed_points(cloud), [[0.1, 0.2, 0.3]])
    assert len(observed_points(cloud[:, :3])) == 2
