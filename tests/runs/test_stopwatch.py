import time

import pytest

from torchgrasp.runs.stopwatch import Stopwatch


def test_time_goes_where_it_was_spent_and_begins_anew():
    stopwatch = Stopwatch()
    with stopwatch.part("rollouts"):
        time.sleep(0.05)
        stopwatch.count("rollouts", 100, of="env_steps")
    for _ in range(2):
        with stopwatch.part("updates"):
            time.sleep(0.02)
        stopwatch.count("updates", 5)
    time.sleep(0.03)
    row = stopwatch.measure()
    assert 0.05 <= row["time/rollouts_s"] < 0.2
    assert 0.04 <= row["time/updates_s"] < 0.2
    assert 0.03 <= row["time/other_s"] < 0.2
    assert row["speed/env_steps_per_s"] * row["time/rollouts_s"] == pytest.approx(100)
    assert row["speed/updates_per_s"] * row["time/updates_s"] == pytest.approx(10)
    again = stopwatch.measure()
    assert again.keys() == {"time/other_s"} and again["time/other_s"] < 0.02


def test_parts_inside_a_part_count_once_and_all_adds_up():
    stopwatch, start = Stopwatch(), time.perf_counter()
    with stopwatch.part("outer"):
        time.sleep(0.02)
        with stopwatch.part("inner"):
            time.sleep(0.05)
            with stopwatch.part("outer"):
                time.sleep(0.02)
    row, whole = stopwatch.measure(), time.perf_counter() - start
    assert 0.05 <= row["time/inner_s"] < 0.09 and 0.04 <= row["time/outer_s"] < 0.08
    assert sum(value for name, value in row.items() if name.startswith("time/")) == pytest.approx(
        whole, abs=0.02
    )


def test_a_part_that_is_still_open_counts_so_far():
    stopwatch = Stopwatch()
    with stopwatch.part("updates"):
        time.sleep(0.03)
        assert 0.03 <= stopwatch.measure()["time/updates_s"] < 0.1
    assert stopwatch.seconds["updates"] < 0.02


def test_an_error_ends_its_part():
    stopwatch = Stopwatch()
    with pytest.raises(ZeroDivisionError), stopwatch.part("updates"):
        stopwatch.seconds["nothing"] = 1 / 0
    time.sleep(0.02)
    assert stopwatch.seconds["updates"] < 0.02


def test_calls_of_a_wrapped_method_are_a_part():
    class Owner:
        def double(self, value: int) -> int:
            time.sleep(0.02)
            return 2 * value

    stopwatch, owner = Stopwatch(), Owner()
    stopwatch.wrap(owner, "double", "doubling")
    assert owner.double(3) == 6 and stopwatch.seconds["doubling"] >= 0.02


def test_memory_is_read_now_and_then():
    stopwatch = Stopwatch(interval=0.05)
    assert "memory/process_mb" in stopwatch.measure()
    assert "memory/process_mb" not in stopwatch.measure()
    time.sleep(0.06)
    assert "memory/process_mb" in stopwatch.measure()


def test_a_part_and_a_reading_cost_next_to_nothing():
    stopwatch = Stopwatch(interval=0.0)
    start = time.perf_counter()
    for _ in range(1000):
        with stopwatch.part("updates"):
            stopwatch.count("updates", 1)
    parts = time.perf_counter() - start
    start = time.perf_counter()
    for _ in range(20):
        stopwatch.measure()
    assert parts < 0.1 and time.perf_counter() - start < 1.0
