import subprocess
import sys
import time

import pytest

from torchgrasp.runs.process_memory import measure_memory
from torchgrasp.runs.stopwatch import Stopwatch


def test_time_goes_where_it_was_spent_and_begins_anew():
    stopwatch = Stopwatch()
    time.sleep(0.05)
    stopwatch.lap("rollouts", 100, of="env_steps")
    for _ in range(2):
        time.sleep(0.02)
        stopwatch.lap("updates", 5)
    time.sleep(0.03)
    stopwatch.lap("other")
    row = stopwatch.measure()
    assert 0.05 <= row["time/rollouts_s"] < 0.2
    assert 0.04 <= row["time/updates_s"] < 0.2
    assert 0.03 <= row["time/other_s"] < 0.2
    assert row["speed/env_steps_per_s"] * row["time/rollouts_s"] == pytest.approx(100)
    assert row["speed/updates_per_s"] * row["time/updates_s"] == pytest.approx(10)
    assert stopwatch.measure() == {}


def test_memory_is_read_now_and_then():
    stopwatch = Stopwatch(interval=0.05)
    assert "memory/process_mb" in stopwatch.measure()
    assert stopwatch.measure() == {}
    time.sleep(0.06)
    assert "memory/process_mb" in stopwatch.measure()


def test_a_lap_and_a_reading_cost_next_to_nothing():
    stopwatch = Stopwatch(interval=0.0)
    start = time.perf_counter()
    for _ in range(1000):
        stopwatch.lap("updates", 1)
    laps = time.perf_counter() - start
    start = time.perf_counter()
    for _ in range(20):
        stopwatch.measure()
    assert laps < 0.1 and time.perf_counter() - start < 1.0


def test_what_is_allocated_shows():
    before = measure_memory()["memory/process_mb"]
    held = bytearray(b"x") * 100_000_000
    grown = measure_memory()["memory/process_mb"] - before
    assert 90 < grown < 150 and len(held) == 100_000_000


def test_children_and_their_children_count():
    before = measure_memory()["memory/children_mb"]
    inner = "held = b'x' * 60_000_000; print('ready', flush=True); input()"
    outer = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {inner!r}])"
    child = subprocess.Popen([sys.executable, "-c", outer], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"ready\n"
        assert measure_memory()["memory/children_mb"] - before > 60
    finally:
        child.communicate(b"\n")
    assert measure_memory()["memory/children_mb"] - before < 30


def test_without_proc_the_highest_so_far_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr("torchgrasp.runs.process_memory._PROC", tmp_path)
    assert measure_memory()["memory/peak_mb"] > 10
    monkeypatch.setitem(sys.modules, "resource", None)  # as on Windows
    assert measure_memory() == {}
