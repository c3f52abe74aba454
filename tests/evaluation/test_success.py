import pytest

from torchgrasp.evaluation.intervals import wilson_interval
from torchgrasp.evaluation.success import SuccessTable


def test_success_table_adds_up():
    table = SuccessTable()
    for name, success in [("mug", True), ("bowl", False), ("mug", False), ("mug", True)]:
        table.add(name, success, cause=None if success else "slipped")
    summary = table.summary()
    counts = {name: (row["episodes"], row["successes"]) for name, row in summary["objects"].items()}
    assert counts == {"bowl": (1, 0), "mug": (3, 2)}
    assert summary["objects"]["mug"]["success_rate"] == pytest.approx(2 / 3)
    assert summary["objects"]["mug"]["success_ci95"] == pytest.approx(wilson_interval(2, 3))
    assert summary["objects"]["mug"]["failures"] == {"slipped": 1}
    assert summary["failures"] == {"slipped": 2}
    assert (summary["episodes"], summary["success_rate"]) == (4, 0.5)
    assert summary["success_ci95"] == pytest.approx(wilson_interval(2, 4))
