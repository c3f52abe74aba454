"""One process at a time owns a folder, and none for longer than it lives."""

import subprocess
import sys
import warnings

import pytest

from torchgrasp.data.folder_lock import own_folder
from torchgrasp.errors import StorageError

HOLDER = """
import sys
from torchgrasp.data.folder_lock import own_folder
with own_folder(sys.argv[1]):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_process_is_refused_until_the_first_is_gone_however_that_ends(tmp_path):
    command, pipe = [sys.executable, "-c", HOLDER, str(tmp_path)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        with pytest.raises(StorageError, match=f"^{tmp_path} is being written by another process: wait"):
            own_folder(tmp_path).__enter__()
        holder.kill()
    with own_folder(tmp_path):
        assert not list(tmp_path.iterdir())


def test_it_can_be_owned_again_afterwards_and_nothing_warns(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(2):
            with own_folder(tmp_path):
                pass


def test_a_folder_that_is_gone_is_named(tmp_path):
    with pytest.raises(StorageError, match="gone cannot be written"), own_folder(tmp_path / "gone"):
        pass
