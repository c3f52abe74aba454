"""recipes/curves.py: learning curves over runs."""

import csv

import pytest

from recipes import curves
from torchgrasp.errors import ConfigError


@pytest.fixture
def runs(tmp_path):
    """Three run directories whose rates at 0 and 100 steps are known, and one of another recipe."""
    for seed, last in enumerate((0.4, 0.6, 0.8)):
        folder = tmp_path / "runs" / f"seed_{seed}"
        folder.mkdir(parents=True)
        (folder / "metrics.csv").write_text(f"step,env_steps,train/success_rate\n1,0,0\n2,100,{last}\n")
    (tmp_path / "runs" / "seed_evaluate").mkdir()
    return tmp_path / "runs"


def find_output(tmp_path):
    (folder,) = tmp_path.glob("curves/*")
    return folder


def test_a_pattern_gives_one_curve(composed, runs, tmp_path):
    curves.draw(composed(f"runs={runs}/*", recipe="curves"))
    folder = find_output(tmp_path)
    with (folder / "curves.csv").open() as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == ["label", "env_steps", "mean", "std", "runs"]
    assert [rows[2][0], rows[2][1], rows[2][4]] == ["train/success_rate", "100", "3"]
    assert [float(cell) for cell in rows[2][2:4]] == pytest.approx([0.6, 0.2])
    assert (folder / "curves.svg").read_text().startswith("<svg")
    assert (folder / "curves.png").read_bytes()[:4] == b"\x89PNG"


def test_labels_give_a_curve_each(composed, runs):
    groups = f"runs={{first: {runs}/seed_0, others: [{runs}/seed_1, '{runs}/seed_[12]']}}"
    drawn = curves.draw(composed(groups, "x=step", recipe="curves"))
    assert {label: curve.runs for label, curve in drawn.items()} == {"first": 1, "others": 2}
    assert drawn["others"].mean.tolist() == pytest.approx([0.0, 0.7])


def test_what_is_not_there_is_named(composed, runs):
    with pytest.raises(ConfigError, match=r"nowhere.* no run directory"):
        curves.draw(composed(f"runs={runs}/nowhere*", recipe="curves"))
    with pytest.raises(ConfigError, match="runs must be given"):
        curves.draw(composed(recipe="curves"))
    with pytest.raises(ConfigError, match="no 'loss'"):
        curves.draw(composed(f"runs=[{runs}/seed_0]", "metric=loss", recipe="curves"))
