import csv

import numpy as np
import pytest

from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.evaluation.learning_curves import (
    Curve,
    LearningCurve,
    average_curves,
    read_curve,
    read_metrics,
    write_curves_csv,
)
from torchgrasp.runs.metrics import MetricsLogger


def write_run(folder, text: str):
    folder.mkdir(parents=True)
    (folder / "metrics.csv").write_text(text)
    return folder


def curve(x, y, run="run") -> Curve:
    return Curve(run, np.array(x, float), np.array(y, float))


def test_three_seeds_by_hand():
    average = average_curves([curve([0, 10], [v, w]) for v, w in [(0.1, 0.4), (0.2, 0.6), (0.6, 0.8)]])
    np.testing.assert_allclose(average.mean, [0.3, 0.6])
    # (0.04 + 0.01 + 0.09) / 2 and (0.04 + 0 + 0.04) / 2
    np.testing.assert_allclose(average.std, [np.sqrt(0.07), 0.2])
    assert average.runs == 3


def test_other_steps_are_interpolated_and_other_lengths_cut():
    average = average_curves([curve([0, 4, 8], [0, 4, 0]), curve([2, 6], [1, 1])])
    np.testing.assert_array_equal(average.x, [2, 4, 6])
    np.testing.assert_allclose(average.mean, [1.5, 2.5, 1.5])
    np.testing.assert_allclose(average.std, np.array([1, 3, 1]) / np.sqrt(2))


def test_the_order_of_runs_changes_nothing_and_a_copy_has_no_spread():
    one, other = curve([0, 3, 5], [1, 2, 0]), curve([1, 5], [4, 4])
    np.testing.assert_allclose(average_curves([one, other]).mean, average_curves([other, one]).mean)
    np.testing.assert_array_equal(average_curves([one, one]).std, [0, 0, 0])


def test_a_single_run_has_no_spread_to_tell():
    alone = average_curves([curve([1, 2], [5, 7])])
    assert alone.mean.tolist() == [5, 7] and np.isnan(alone.std).all()


def test_runs_that_do_not_overlap_are_named():
    with pytest.raises(ConfigError, match="early ends at 2, before late begins at 3"):
        average_curves([curve([1, 2], [0, 0], "early"), curve([3, 4], [0, 0], "late")])
    with pytest.raises(ConfigError, match="no curves"):
        average_curves([])


def test_rows_without_the_metric_are_no_points(tmp_path):
    run = write_run(tmp_path / "a", "step,loss,env_steps,rate\n0,2,,\n5,,10,0.25\n6,1,,\n9,1,30,0.5\n")
    read = read_curve(run, "rate", x="env_steps")
    assert (read.run, read.x.tolist(), read.y.tolist()) == ("a", [10, 30], [0.25, 0.5])
    assert read_curve(run, "loss").x.tolist() == [0, 6, 9]


def test_what_a_resumed_run_did_again_holds(tmp_path):
    run = write_run(tmp_path / "a", "step,rate\n0,0.0\n10,0.1\n20,0.2\n30,0.3\n15,0.5\n25,0.6\n25,0.7\n")
    read = read_curve(run, "rate")
    assert read.x.tolist() == [0, 10, 15, 25]
    assert read.y.tolist() == [0.0, 0.1, 0.5, 0.7]


def test_what_the_logger_writes_is_read_and_a_cut_line_left_out(tmp_path):
    logger = MetricsLogger(tmp_path)
    logger.log(0, {"loss": 1 / 3})
    logger.log(7, {"loss": 2, "a, b": 0.5})
    with (tmp_path / "metrics.csv").open("a") as stream:
        stream.write("8")
    read = read_metrics(tmp_path)
    assert read["step"].tolist() == [0, 7] and read["loss"].tolist() == [1 / 3, 2]
    assert np.isnan(read["a, b"][0]) and read["a, b"][1] == 0.5


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("", CheckpointError, "no rows yet"),
        ("step,rate\n", CheckpointError, "no rows yet"),
        ("step,rate\n1,many\n", CheckpointError, "damaged .*many"),
        ("step,other\n1,2\n", ConfigError, "no 'rate' in metrics.csv: choose from step, other"),
        ("step,env,rate\n1,,2\n2,7,\n", ConfigError, "'rate' and 'env' never stand in one row"),
        ("step,rate\n1,2\n", ConfigError, "no 'env' in metrics.csv"),
        ("step,env,rate\n1,5,2\n2,6,nan\n", ConfigError, "'rate' is no number from env=6 on"),
        ("step,env,rate\n1,5,-inf\n", ConfigError, "'rate' is no number from env=5 on"),
    ],
)
def test_what_cannot_be_read_says_why(tmp_path, text, error, message):
    with pytest.raises(error, match=message):
        read_curve(write_run(tmp_path / "run", text), "rate", x="env")


def test_a_folder_without_metrics_is_named(tmp_path):
    with pytest.raises(CheckpointError, match=r"no .*metrics\.csv"):
        read_metrics(tmp_path)


def test_table_has_a_row_a_point_with_all_digits(tmp_path):
    curves = {
        "BC, points": LearningCurve(np.array([2e6 + 1]), np.array([1 / 3]), np.array([0.1]), 3),
        "RL": LearningCurve(np.array([0.5]), np.array([1.0]), np.array([np.nan]), 1),
    }
    write_curves_csv(tmp_path / "curves.csv", curves, x="env_steps")
    with (tmp_path / "curves.csv").open(newline="") as stream:
        assert list(csv.reader(stream)) == [
            ["label", "env_steps", "mean", "std", "runs"],
            ["BC, points", "2000001", repr(1 / 3), "0.1", "3"],
            ["RL", "0.5", "1.0", "", "1"],
        ]


@pytest.mark.parametrize(
    "content",
    [
        b"step,rate\n1,\xff\n",
        "step,rate\n1,2\n".encode("utf-16"),
        b"\xef\xbb\xbfstep,rate\n1,2\n",
        b'step,"rate\n1,2\n' + b"x" * 200_000,
        b"step,step\n1,2\n",
        b"rate,loss\n1,2\n",
        b"\x00" * 100,
        b"{}",
    ],
)
def test_a_damaged_file_is_one_line(tmp_path, content):
    (tmp_path / "metrics.csv").write_bytes(content)
    for read in (read_metrics, lambda run: MetricsLogger(run, resume_step=3)):
        with pytest.raises(CheckpointError, match=r"metrics\.csv") as error:
            read(tmp_path)
        assert "\n" not in str(error.value)
