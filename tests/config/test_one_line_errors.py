import pickle
import signal
import subprocess
import sys

import pytest

from tests import warm_python
from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.errors import ConfigError, StorageError


@one_line_errors()
def decorated(value: int) -> int:
    """Of this module, so that it can be pickled by its name."""
    if value < 0:
        raise ConfigError("too\nsmall")
    return 2 * value


def test_what_it_decorates_keeps_its_value_and_can_be_called_again(capsys):
    assert (decorated(2), decorated(3)) == (4, 6)
    for _ in range(2):
        with pytest.raises(SystemExit) as caught:
            decorated(-1)
        assert caught.value.code == 1 and capsys.readouterr().err == "error: too small\n"


def test_it_can_be_sent_to_another_process():
    guard = pickle.loads(pickle.dumps(one_line_errors()))
    with pytest.raises(SystemExit), guard:
        raise ConfigError("no")


@pytest.mark.parametrize(
    "unbuffered", [[], pytest.param(["-u"], marks=pytest.mark.slow)], ids=["buffered", "unbuffered"]
)
def test_output_that_nobody_reads_ends_without_a_word(unbuffered):
    script = """
import sys
from torchgrasp.config.one_line_errors import one_line_errors

@one_line_errors()
def main():
    sys.stdin.readline()
    for _ in range(3):
        print("x" * 9000)

main()
"""
    command = [sys.executable, *unbuffered, "-c", script]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, text=True, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        process.stdout.close()
        process.stdin.write("go on\n")
        process.stdin.close()
        assert process.stderr.read() == ""


def test_how_to_go_on_stands_behind_the_error_in_the_same_line(capsys):
    with pytest.raises(SystemExit), one_line_errors():
        error = StorageError("no room")
        error.add_note("In a worker:\nits traceback")
        error.add_note("Go on with resume=DIR")
        raise error
    assert capsys.readouterr().err == "error: no room. Go on with resume=DIR\n"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interruption_is_one_line_and_its_exit_code(tmp_path, number, code):
    script = tmp_path / "script.py"
    script.write_text(f"""
import os
from torchgrasp.config.one_line_errors import one_line_errors

@one_line_errors()
def main():
    os.kill(os.getpid(), {int(number)})

main()
""")
    done = warm_python.run([sys.executable, str(script)], timeout=60)
    told = f"interrupted by {signal.Signals(number).name}\n"
    assert (done.returncode, done.stdout, done.stderr) == (code, "", told)
