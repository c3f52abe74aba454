import mmap
import subprocess
import sys

from torchgrasp.runs.process_memory import measure_memory


def test_what_is_allocated_shows():
    before = measure_memory()["memory/process_mb"]
    # Pages of its own: malloc would take what earlier tests have freed, which is resident already.
    held = mmap.mmap(-1, 100_000_000)
    held.write(b"x" * 100_000_000)
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


def test_a_child_that_has_ended_weighs_nothing():
    before = measure_memory()["memory/children_mb"]
    child = subprocess.Popen([sys.executable, "-c", "pass"], stdout=subprocess.PIPE)
    assert child.stdout is not None
    child.stdout.read()  # until it ends; nobody has waited for it, so that it is still listed
    assert measure_memory()["memory/children_mb"] - before < 30
    child.wait()
