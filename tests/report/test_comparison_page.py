import csv
import io

import pytest

from tests.run_files import compare_four_groups, write_run
from torchgrasp.evaluation.comparison import compare_runs
from torchgrasp.evaluation.run_results import read_result
from torchgrasp.report.comparison_page import to_csv, to_markdown, to_page, to_text, write_comparison


@pytest.fixture
def rows(tmp_path):
    return compare_four_groups(tmp_path)


def test_the_tables_hold_the_same_numbers(rows, tmp_path):
    markdown, text, page = to_markdown(rows, title="A | B"), to_text(rows), to_page(rows, title="<b>")
    for cell in ("40.0 ± 10.0 %", "30.0, 40.0, 50.0", "40.0 % [24.6, 57.7]", "+30.0 points", "[+5.2, +54.8]"):
        assert cell in markdown and cell in text and cell in page
    assert "| without | 10.0 | 33,600 | 5,000 |" in markdown and "| with | 20.0 |" in markdown
    assert "| alone | 0 | 100.0 | 100.0 % |" in markdown and "one run: no interval" in text
    assert "<td>evaluation.seed</td><td>1000</td>" in page and "<h1>&lt;b&gt;</h1>" in page
    assert "src=" not in page and "href=" not in page  # it loads nothing
    paths = write_comparison(tmp_path, rows, title="A | B")
    assert [path.read_text() for path in paths[:2]] == [markdown, to_csv(rows)]


def test_the_csv_has_every_digit(rows):
    first, second, _, alone = csv.DictReader(io.StringIO(to_csv(rows)))
    assert (first["seeds"], first["values"], first["difference"]) == ("0;1;2", "0.3;0.4;0.5", "")
    assert float(second["difference_low_over_seeds"]) == pytest.approx(0.3 - 0.2484138)
    assert (second["method"], float(second["wall_minutes"]), second["episodes"]) == ("paired", 20.0, "30")
    assert (alone["std"], alone["method"], alone["difference_low_over_seeds"]) == ("", "", "")


def test_a_measure_that_is_no_success_rate_has_no_drawn_interval(tmp_path):
    prediction = {"actor": {"trajectories": 7, "expert_goal": {"translation_m": {"min": 0.02, "mean": 0.05}}}}
    run = read_result(write_run(tmp_path / "run", 0, 8, grasp_prediction=prediction), key="grasp_prediction")
    rows = compare_runs({"one": [run], "same": [run]})
    page = to_page(rows, title="Predictions")
    assert "0.02" in to_text(rows) and "<td>0.02</td>" in page and "<svg" not in page
    assert to_page(compare_four_groups(tmp_path / "rates"), title="Rates").count("<svg") == 4
