import csv

from torchgrasp.runs.metrics import MetricsLogger


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


def test_every_byte_of_the_file_is_as_spreadsheets_expect(tmp_path):
    logger = MetricsLogger(tmp_path)
    logger.log(0, {"loss": 0.1, "train/rate": 3})
    logger.log(7, {"loss": 1e-7, 'so "named", twice': -2.0})
    logger.log(9, {"train/rate": float("nan")})
    lines = ['step,loss,train/rate,"so ""named"", twice"', "0,0.1,3,", "7,1e-07,,-2", "9,,nan,", ""]
    assert (tmp_path / "metrics.csv").read_bytes() == "\r\n".join(lines).encode()


def test_resuming_drops_what_followed_the_checkpoint(tmp_path):
    logger = MetricsLogger(tmp_path)
    for step in range(0, 50, 10):
        logger.log(step, {"loss": step / 4})
    with (tmp_path / "metrics.csv").open("a") as stream:
        stream.write("5")  # the line that a kill cut off
    logger = MetricsLogger(tmp_path, resume_step=30)
    logger.log(30, {"loss": 9.5, "new": 1})
    assert [(row["step"], row["loss"], row["new"]) for row in read(tmp_path)] == [
        ("0", "0", ""),
        ("10", "2.5", ""),
        ("20", "5", ""),
        ("30", "9.5", "1"),
    ]
