import multiprocessing
import os
import signal
import time

from torchgrasp.errors import ObjectError
from torchgrasp.objects.cache import cached, load_or_build, locked

FORK = multiprocessing.get_context("fork")


def _build_slowly(path, start):
    def build():
        with open(path.parent / "builds", "a") as log:
            log.write("x")
        time.sleep(0.3)
        return "built"

    start.wait()
    cached(path, build, load=lambda file: file.read_text(), save=lambda file, text: file.write_text(text))


def test_processes_that_ask_at_once_build_once(tmp_path):
    start = FORK.Barrier(4)
    processes = [FORK.Process(target=_build_slowly, args=(tmp_path / "item", start)) for _ in range(4)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(timeout=20)
    assert (tmp_path / "builds").read_text() == "x"
    assert sorted(os.listdir(tmp_path)) == ["builds", "item"]


def _refuse_slowly(path, start):
    def build():
        with open(path.parent / "builds", "a") as log:
            log.write("x")
        time.sleep(0.3)
        raise ObjectError("mug.stl is broken: remove it.")

    start.wait()
    try:
        load_or_build(path, build)
    except ObjectError as error:
        assert str(error).startswith("mug.stl")


def test_a_refusal_is_found_once_and_remembered(tmp_path):
    start = FORK.Barrier(3)
    processes = [FORK.Process(target=_refuse_slowly, args=(tmp_path / "mug.npz", start)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(timeout=20)
    assert [process.exitcode for process in processes] == [0, 0, 0]
    assert (tmp_path / "builds").read_text() == "x"
    assert sorted(os.listdir(tmp_path)) == ["builds", "mug.refused"]


def _hold(path, held):
    with locked(path):
        held.set()
        time.sleep(60)


def test_a_killed_builder_leaves_no_dead_lock(tmp_path):
    held = FORK.Event()
    process = FORK.Process(target=_hold, args=(tmp_path / "item", held))
    process.start()
    assert held.wait(timeout=10)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join(timeout=10)
    start = time.perf_counter()
    with locked(tmp_path / "item"):
        assert time.perf_counter() - start < 5
    assert os.listdir(tmp_path) == []
