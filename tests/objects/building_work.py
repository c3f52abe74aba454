"""Work for other processes, which import this module without the library's packages."""

import os
import signal
import time

from torchgrasp.errors import ObjectError


def leave_process(folder, index):
    (folder / str(index)).write_text(str(os.getpid()))


def refuse_two(index):
    if index == 2:
        raise ObjectError("two.stl is broken: remove it.")


def die_at_two(index):
    if index == 2:
        os.kill(os.getpid(), signal.SIGKILL)


def take_long(index):
    time.sleep(0.2 if index else 2.5)


def hang(folder, index):
    leave_process(folder, index)
    time.sleep(600)
