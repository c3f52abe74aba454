import csv
import io

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchgrasp.evaluation.intervals import wilson_interval
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.runs.metrics import MetricsLogger
from torchgrasp.runs.progress import Progress


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        # Computed by hand from the formula with z = 1.959964.
        (5, 10, 0.2366, 0.7634),
        (81, 100, 0.7222, 0.8749),
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (0, 0, 0.0, 1.0),
    ],
)
def test_wilson_interval_against_known_values(successes, n, low, high):
    assert wilson_interval(successes, n) == pytest.approx((low, high), abs=1e-4)


def test_wilson_interval_is_symmetric_and_widens_with_confidence():
    low, high = wilson_interval(3, 20)
    assert wilson_interval(17, 20) == pytest.approx((1 - high, 1 - low))
    wide = wilson_interval(3, 20, confidence=0.99)
    assert wide[0] < low < 3 / 20 < high < wide[1]


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


def read(path):
    with (path / "metrics.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_columns_grow_and_values_keep_every_bit(tmp_path):
    logger = MetricsLogger(tmp_path)
    logger.log(0, {"loss": 1 / 3})
    logger.log(1_234_567, {"loss": 2, "success, all": 123456789.0})
    logger.close()
    assert read(tmp_path) == [
        {"step": "0", "loss": repr(1 / 3), "success, all": ""},
        {"step": "1234567", "loss": "2", "success, all": "123456789"},
    ]


def test_resuming_drops_what_followed_the_checkpoint(tmp_path):
    logger = MetricsLogger(tmp_path, tensorboard=False)
    for step in range(0, 50, 10):
        logger.log(step, {"loss": step / 4})
    with (tmp_path / "metrics.csv").open("a") as stream:
        stream.write("5")  # the line that a kill cut off
    logger = MetricsLogger(tmp_path, resume_step=30, tensorboard=False)
    logger.log(30, {"loss": 9.5, "new": 1})
    assert [(row["step"], row["loss"], row["new"]) for row in read(tmp_path)] == [
        ("0", "0", ""),
        ("10", "2.5", ""),
        ("20", "5", ""),
        ("30", "9.5", "1"),
    ]


def test_tensorboard_reads_the_scalars(tmp_path):
    logger = MetricsLogger(tmp_path)
    logger.log(3, {"loss": 0.25})
    logger.close()
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [(event.step, event.value) for event in events.Scalars("loss")] == [(3, 0.25)]


def test_progress_in_a_file_is_a_line_now_and_then():
    stream = io.StringIO()
    with Progress(100, initial=40, description="train", interval=0.0, stream=stream) as progress:
        progress.update(10, success_rate=0.25)
    first, last = stream.getvalue().splitlines()
    assert first.startswith("train: 50/100 steps")
    assert "to go" in first and "success 25 %" in first
    assert "\r" not in last
    quiet = io.StringIO()
    Progress(100, stream=quiet).update(10)
    assert not quiet.getvalue()
