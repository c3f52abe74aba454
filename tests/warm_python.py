"""A Python that has the big packages loaded, to be copied: a process of ours then starts at once.

Nothing of this project is loaded: each copy imports that, and is otherwise a process like any other, with
arguments, environment, streams, signals and exit code of its own. Tests of what happens before or at the
import of torch start a Python anew.
"""

from __future__ import annotations

import array
import atexit
import contextlib
import functools
import gc
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from importlib import import_module
from pathlib import Path
from typing import IO

_PACKAGES = [
    *("torchrl.collectors", "torchrl.data", "torchrl.envs", "torchrl.modules", "torchrl.objectives"),
    *("tensordict.nn", "sapien", "roma", "trimesh", "scipy.optimize", "scipy.spatial", "scipy.stats"),
    *("hydra", "pydantic.main", "jinja2", "psutil", "safetensors.torch", "tqdm"),
]
_STREAMS = ("stdin", "stdout", "stderr")
_TEXT: dict[str, dict] = {"stdin": {}, "stdout": {"mode": "w"}}
_TEXT["stderr"] = {"mode": "w", "buffering": 1, "errors": "backslashreplace"}


class WarmProcess:
    """`subprocess.Popen` for a script of Python, as far as tests use it: text streams, DEVNULL and PIPE.

    Args:
        command: [sys.executable, script, arguments...].
        env: its environment; None for that of this process.
        cwd: its folder; None for that of this process.
        start_new_session: whether it leads a session of its own.
        streams: `stdin`, `stdout`, `stderr`: None to inherit, PIPE or DEVNULL; `stderr` STDOUT, too.
    """

    def __init__(
        self,
        command: list[str],
        *,
        env: dict[str, str] | None = None,
        cwd: Path | None = None,
        start_new_session: bool = False,
        **streams: int,
    ) -> None:
        self.args, self.returncode = command, None
        self.stdin, self.stdout, self.stderr = None, None, None
        theirs: list[int] = []
        for name in _STREAMS:
            wanted = streams.get(name)
            joined = wanted == subprocess.STDOUT
            theirs.append(os.dup(theirs[1]) if joined else self._open(len(theirs), wanted))
        self._ended, ended = os.pipe()
        told = {"arguments": command[1:], "session": start_new_session, "folder": str(cwd or Path.cwd())}
        told["environment"] = dict(os.environ if env is None else env)
        self.pid = _server().start(told, [*theirs, ended])
        for each in (*theirs, ended):
            os.close(each)

    def _open(self, number: int, wanted: int | None) -> int:
        """The descriptor that the process gets for a stream."""
        if wanted is None:
            return os.dup(number)
        if wanted == subprocess.DEVNULL:
            return os.open(os.devnull, os.O_RDWR)
        reading, writing = os.pipe()
        ours, theirs, mode = (writing, reading, "w") if number == 0 else (reading, writing, "r")
        setattr(self, _STREAMS[number], os.fdopen(ours, mode, encoding="utf-8"))
        return theirs

    def poll(self) -> int | None:
        """The exit code, -N where signal N killed it, None while it runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; raises TimeoutExpired."""
        if self.returncode is None:
            if not select.select([self._ended], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout or 0)
            self.returncode = os.waitstatus_to_exitcode(int(os.read(self._ended, 16)))
            os.close(self._ended)
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What it writes to pipes until all that hold them have closed them; raises TimeoutExpired."""
        if self.stdin is not None:
            self.stdin.close()
        deadline = None if timeout is None else time.monotonic() + timeout
        read: dict[str, str] = {}
        readers = [
            threading.Thread(target=_read, args=(stream, name, read), daemon=True)
            for name in _STREAMS[1:]
            if (stream := getattr(self, name)) is not None
        ]
        for each in readers:
            each.start()
        for each in readers:
            each.join(None if deadline is None else max(0.0, deadline - time.monotonic()))
            if each.is_alive():
                raise subprocess.TimeoutExpired(self.args, timeout or 0)
        self.wait(None if deadline is None else max(0.0, deadline - time.monotonic()))
        return read.get("stdout", ""), read.get("stderr", "")

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    terminate = functools.partialmethod(send_signal, signal.SIGTERM)
    kill = functools.partialmethod(send_signal, signal.SIGKILL)

    def __enter__(self) -> WarmProcess:
        return self

    def __exit__(self, *_: object) -> None:
        for name in _STREAMS:
            if (stream := getattr(self, name)) is not None:
                stream.close()
        self.wait()


def run(command: list[str], *, timeout: float, **options) -> subprocess.CompletedProcess:
    """`subprocess.run` with captured text for a script of Python; see `WarmProcess`."""
    process = WarmProcess(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)
    try:
        out, err = process.communicate(timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return subprocess.CompletedProcess(command, process.wait(), out, err)


def _read(stream: IO[str], name: str, into: dict[str, str]) -> None:
    into[name] = stream.read()


class _Server:
    def __init__(self) -> None:
        self._channel, theirs = socket.socketpair()
        found = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"import {__name__} as warm; warm.serve({theirs.fileno()})()"],
            pass_fds=[theirs.fileno()],
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(found)},
        )
        theirs.close()

    def start(self, told: dict, descriptors: list[int]) -> int:
        """The process id of a copy that was told what to run and given its streams."""
        packed = json.dumps(told).encode()
        ancillary = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", descriptors))]
        self._channel.sendmsg([len(packed).to_bytes(8, "big")], ancillary)
        self._channel.sendall(packed)
        return int.from_bytes(_receive(self._channel, 8), "big")


@functools.cache
def _server() -> _Server:
    return _Server()


def _receive(channel: socket.socket, count: int) -> bytes:
    received = b""
    while len(received) < count:
        received += (part := channel.recv(count - len(received)))
        if not part:
            raise EOFError
    return received


def serve(descriptor: int) -> functools.partial:
    """The life of the server; in each copy of it, what the copy is to do."""
    for name in _PACKAGES:
        import_module(name)
    gc.freeze()  # so that copies share it
    channel = socket.socket(fileno=descriptor)
    wake, woken = os.pipe()
    os.set_blocking(woken, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.set_wakeup_fd(woken)
    running: dict[int, int] = {}  # process id -> where its end is told
    while True:
        ready, _, _ = select.select([channel, wake], [], [])
        if wake in ready:
            os.read(wake, 4096)
            _tell_ends(running)
        if channel not in ready:
            continue
        size, descriptors, *_ = socket.recv_fds(channel, 8, 4)
        if not size:
            os._exit(0)
        told = json.loads(_receive(channel, int.from_bytes(size, "big")))
        if not (child := os.fork()):
            signal.set_wakeup_fd(-1)
            for each in (*running.values(), wake, woken, channel.detach(), descriptors.pop()):
                os.close(each)
            return functools.partial(_become, told, descriptors)
        running[child] = descriptors.pop()
        for each in descriptors:
            os.close(each)
        channel.sendall(child.to_bytes(8, "big"))


def _tell_ends(running: dict[int, int]) -> None:
    for child in list(running):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            told = running.pop(child)
            with contextlib.suppress(BrokenPipeError):  # nobody waits for it any more
                os.write(told, str(status).encode())
            os.close(told)


def _become(told: dict, descriptors: list[int]) -> None:
    """Run the script as the main one."""
    if told["session"]:
        os.setsid()
    for number, each in enumerate(descriptors):
        os.dup2(each, number)
        os.close(each)
    for name, options in _TEXT.items():  # the server's know what kind of file they were opened on
        setattr(sys, name, open(_STREAMS.index(name), **options))  # noqa: SIM115
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.clear()
    os.environ.update(told["environment"])
    os.chdir(told["folder"])
    atexit.register(gc.unfreeze)  # what is never freed is told of at the end
    script, sys.argv = told["arguments"][0], told["arguments"]
    sys.path[:2] = [str(Path(script).parent)]  # as for any script: without this project's root
    runpy.run_path(script, run_name="__main__")
