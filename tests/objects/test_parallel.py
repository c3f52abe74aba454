import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import psutil
import pytest

from tests import warm_python
from tests.objects.building_work import die_at_two, leave_process, refuse_two, take_long
from tests.warm_python import WarmProcess
from torchgrasp.errors import ObjectError
from torchgrasp.objects.parallel import run_each

HERE = str(Path(__file__).parent)


@pytest.mark.parametrize("workers", [1, None])
def test_every_index_is_worked_on_once(tmp_path, workers):
    run_each(partial(leave_process, tmp_path), range(5), workers=workers, label="test")
    processes = {file.name: int(file.read_text()) for file in tmp_path.iterdir()}
    assert sorted(processes) == list("01234")
    assert (os.getpid() in processes.values()) == (workers == 1 or len(os.sched_getaffinity(0)) == 1)
    run_each(partial(leave_process, tmp_path / "missing"), [], workers=workers, label="test")


@pytest.mark.parametrize("workers", [1, 2])
def test_what_stops_the_work_is_raised(workers):
    with pytest.raises(ObjectError, match=r"^two\.stl is broken: remove it\.$"):
        run_each(refuse_two, range(4), workers=workers, label="test")


def test_the_object_at_which_a_process_dies_is_named():
    with pytest.raises(ObjectError, match=r"^cup could not be prepared: its process was killed by SIGKILL"):
        run_each(
            die_at_two, range(4), workers=2, label="test", name=["box", "bowl", "cup", "mug"].__getitem__
        )


@pytest.mark.parametrize("workers", [1, 2])
def test_a_line_says_what_takes_long_and_nothing_is_said_of_what_does_not(workers, capfd):
    run_each(take_long, [0, 1], workers=workers, label="building", name=["slow", "fast"].__getitem__)
    told = capfd.readouterr().err
    assert "building:" in told and "slow" in told and told.endswith("\n") and "2/2" in told
    run_each(take_long, [1], workers=workers, label="building", name=["slow", "fast"].__getitem__)
    run_each(take_long, [0], workers=workers, label="building", progress=False)
    assert capfd.readouterr().err == ""


def run_script(tmp_path, body):
    script = tmp_path / "script.py"
    script.write_text(f"import sys\nsys.path.insert(0, {HERE!r})\nprint('running', flush=True)\n{body}\n")
    return [sys.executable, str(script)]


def test_a_script_without_a_main_guard_runs_once(tmp_path):
    (tmp_path / "out").mkdir()
    command = run_script(
        tmp_path,
        "from functools import partial\nfrom pathlib import Path\n"
        "from building_work import leave_process\nfrom torchgrasp.objects.parallel import run_each\n"
        f"work = partial(leave_process, Path({str(tmp_path / 'out')!r}))\n"
        "run_each(work, range(4), workers=2, label='test', progress=False)",
    )
    run = warm_python.run(command, timeout=60)
    assert (run.returncode, run.stdout, run.stderr) == (0, "running\n", "")
    assert len(list((tmp_path / "out").iterdir())) == 4


def test_what_other_processes_cannot_find_is_done_in_this_one(tmp_path):
    command = run_script(
        tmp_path,
        "from torchgrasp.objects.parallel import run_each\n"
        "def work(index): print(index)\n"
        "run_each(work, range(4), workers=2, label='test')",
    )
    run = warm_python.run(command, timeout=60)
    assert (run.returncode, run.stdout) == (0, "running\n0\n1\n2\n3\n")


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_building_processes_end_with_the_one_that_started_them(tmp_path, end):
    (tmp_path / "out").mkdir()
    command = run_script(
        tmp_path,
        "from functools import partial\nfrom pathlib import Path\nfrom building_work import hang\n"
        "from torchgrasp.objects.parallel import run_each\n"
        f"work = partial(hang, Path({str(tmp_path / 'out')!r}))\n"
        "run_each(work, range(4), workers=2, label='test')",
    )
    with WarmProcess(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        builders = wait_for_two(tmp_path / "out")
        process.send_signal(end)
        process.wait(timeout=20)
    assert process.returncode != 0
    gone, alive = psutil.wait_procs(builders, timeout=20)
    assert not alive and len(gone) == 2


def wait_for_two(folder):
    """The processes that have begun."""
    start = time.monotonic()
    while True:
        texts = [file.read_text() for file in folder.iterdir()]
        if len(texts) == 2 and all(texts):
            return [psutil.Process(int(text)) for text in texts]
        assert time.monotonic() - start < 60
        time.sleep(0.05)
