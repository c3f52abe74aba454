"""The first signal ends things in good order, the second at once; in whatever thread it is waited for."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from torchgrasp.errors import ConfigError, StorageError
from torchgrasp.interruption import (
    Interrupted,
    check,
    hold,
    is_interrupted,
    keep_handlers,
    noted,
    release,
    watch_signals,
)

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def send(number: int) -> None:
    os.kill(os.getpid(), number)


@pytest.fixture(autouse=True)
def caught():
    """Ctrl-C is what a terminal's is, also where these tests were started to ignore it; all is undone."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    after = [signal.getsignal(number) for number in SIGNALS]
    assert after == [signal.default_int_handler, before[signal.SIGTERM]]
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_first_signal_is_raised_where_it_comes(number, code):
    with pytest.raises(Interrupted) as interruption, watch_signals():
        send(number)
    assert interruption.value.exit_code == code and not is_interrupted()
    assert str(interruption.value) == f"interrupted by {signal.Signals(number).name}"


def test_it_passes_what_catches_errors():
    with pytest.raises(KeyboardInterrupt), watch_signals():
        try:
            send(signal.SIGTERM)
        except Exception:
            raise AssertionError("caught") from None


def test_held_it_waits_for_the_next_check():
    done = []
    with pytest.raises(Interrupted), watch_signals(), hold():
        send(signal.SIGTERM)
        done.append("the update")
        check()
        done.append("never")
    assert done == ["the update"]


def test_released_it_is_raised_at_once_the_one_that_waited_too():
    with watch_signals(), hold():
        with pytest.raises(Interrupted), release():
            send(signal.SIGTERM)
        with pytest.raises(Interrupted), release():
            raise AssertionError("the signal that came before was lost")


def test_what_a_hold_saves_is_not_interrupted_by_a_scheduler_that_repeats_itself():
    with pytest.raises(Interrupted), watch_signals(), hold():
        for _ in range(3):
            send(signal.SIGTERM)
        check()


def test_a_second_ctrl_c_ends_at_once_and_python_does_not_complain_of_what_it_cleans_up():
    script = """
import multiprocessing, os, signal, time
from torchgrasp.interruption import hold, watch_signals
signal.signal(signal.SIGINT, signal.default_int_handler)
with watch_signals(), hold():
    semaphore = multiprocessing.get_context("spawn").Semaphore()
    os.kill(os.getpid(), signal.SIGINT)
    print("held", flush=True)
    os.kill(os.getpid(), signal.SIGINT)
    print("never", flush=True)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (-signal.SIGINT, "held\n")
    assert done.stderr == "\nctrl-C: saving what there is; once more ends at once, without.\n"


def test_an_inner_watch_and_one_in_another_thread_change_nothing():
    def work():
        with watch_signals(), hold(), release():
            check()
            done.append(threading.current_thread())

    done: list = []
    with pytest.raises(Interrupted), watch_signals():
        with watch_signals():
            handler = signal.getsignal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is handler
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        assert len(done) == 1
        send(signal.SIGTERM)


def test_a_thread_learns_of_the_signal_and_its_hold_does_not_put_off_the_main_ones():
    told: list = []

    def work():
        with hold():
            held.set()
            while not told:
                try:
                    check()
                except Interrupted as interruption:
                    told.append(interruption)
                time.sleep(0.01)

    held, thread = threading.Event(), threading.Thread(target=work)
    with pytest.raises(Interrupted), watch_signals():
        thread.start()
        held.wait()
        try:
            send(signal.SIGTERM)
        finally:
            thread.join(timeout=10)
    assert len(told) == 1


def test_code_of_others_keeps_no_handler():
    with watch_signals():
        ours = signal.getsignal(signal.SIGTERM)
        with keep_handlers():
            signal.signal(signal.SIGTERM, lambda *_: sys.exit(15))
        assert signal.getsignal(signal.SIGTERM) is ours


def test_how_to_go_on_is_noted_where_one_can():
    for error in (Interrupted(signal.SIGINT), StorageError("no room")):
        with pytest.raises(type(error)) as caught, noted("Go on with it."):
            raise error
        assert caught.value.__notes__ == ["Go on with it."]
    with pytest.raises(ConfigError) as caught, noted("Go on with it."):
        raise ConfigError("alpha=2")
    assert not hasattr(caught.value, "__notes__")
