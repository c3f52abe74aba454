"""Hosts made of namespaces on one machine: each with a network, processes, files and a name of its own.

All of it lives in the namespaces of `call_in_namespaces`: nothing is left when that call ends. Needs Linux
with `unshare` and `nsenter` (util-linux) and `ip` (iproute2).
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import psutil

_TOOLS = {"unshare": "util-linux", "nsenter": "util-linux", "ip": "iproute2", "mount": "mount"}
_SPACES = ("--net", "--mount", "--uts", "--ipc", "--pid")
_SUBNET = "10.77.0"
_SWITCH = "switch"


def tell_lack() -> str | None:
    """What keeps this machine from making hosts, None where it can."""
    if not sys.platform.startswith("linux"):
        return f"network namespaces are of Linux, this is {sys.platform}"
    if lacking := [tool for tool in _TOOLS if shutil.which(tool) is None]:
        return f"{lacking[0]} is missing: install {_TOOLS[lacking[0]]}"
    script = f"ip link add name {_SWITCH} type bridge && ip link add name one type veth peer name other"
    script += " && mount -t tmpfs none /mnt"
    tried = subprocess.run([*_unshare(), "sh", "-c", script], capture_output=True, text=True)
    if tried.returncode:
        told = (tried.stderr.strip().splitlines() or [f"exit code {tried.returncode}"])[-1]
        return f"namespaces may not be made here ({told}): it takes root with CAP_SYS_ADMIN and CAP_NET_ADMIN"
    return None


def _unshare() -> list[str]:
    """The command that runs another one in new namespaces, as root of a new one of users where need be."""
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    return ["unshare", *user, *_SPACES, "--fork", "--kill-child", "--mount-proc"]


def call_in_namespaces(*arguments: str) -> int:
    """The exit code of a Python script that ran in namespaces of its own, of which nothing is left.

    SIGTERM ends it like an error.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with subprocess.Popen([*_unshare(), sys.executable, *arguments]) as process:
        try:
            return process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                time.sleep(1.0)  # the kernel ends what is inside, which may be writing


class Network:
    """A switch and the hosts on its ports.

    Args:
        folder: where hosts keep their files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._hosts = folder, 0
        _call("ip", "link", "add", "name", _SWITCH, "type", "bridge")
        _call("ip", "link", "set", _SWITCH, "up")

    def add_host(self, name: str, *, hidden: Sequence[Path] = ()) -> Host:
        """A host on the next port, which sees empty folders where `hidden` are."""
        self._hosts += 1
        return Host(name, f"{_SUBNET}.{self._hosts}", self._folder / name, hidden=hidden)


class Host:
    """A machine as far as its programs can tell: with processes, network, name and home of its own.

    Args:
        name: what it calls itself.
        address: IPv4.
        folder: its home.
        hidden: folders that are empty there.
    """

    def __init__(self, name: str, address: str, folder: Path, *, hidden: Sequence[Path] = ()) -> None:
        self.name, self.address, self.folder = name, address, folder
        folder.mkdir(parents=True)
        mounts = [Path("/dev/shm"), *hidden]
        script = (
            f"hostname {name}; for each; do mount -t tmpfs none $each || exit; done; echo up; sleep infinity"
        )
        command = ["unshare", *_SPACES, "--fork", "--kill-child", "--mount-proc", "sh", "-c", script, "sh"]
        self._unshared = subprocess.Popen([*command, *map(str, mounts)], stdout=subprocess.PIPE, text=True)
        assert self._unshared.stdout is not None
        if self._unshared.stdout.readline() != "up\n":
            raise RuntimeError(f"the host {name} does not start")
        (first,) = psutil.Process(self._unshared.pid).children()
        self._pid = first.pid
        _call(
            "ip", "link", "add", "name", name, "type", "veth", "peer", "name", "eth0", "netns", str(self._pid)
        )
        _call("ip", "link", "set", name, "master", _SWITCH, "up")
        addressed = ("link set lo up", "link set eth0 up", f"addr add {address}/24 dev eth0")
        for given in (*addressed, "route add default dev eth0"):  # Ray looks for the way out
            _call(*self._enter("ip", *given.split()))

    def _enter(self, *command: str) -> list[str]:
        return ["nsenter", "--target", str(self._pid), *_SPACES, *command]

    def start(self, *command: str, log: Path, env: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
        """A program of the host, in its home, that writes into `log`."""
        whole = {**os.environ, "HOME": str(self.folder), **(env or {})}
        with log.open("a") as stream:
            return subprocess.Popen(
                self._enter(*command), env=whole, cwd=self.folder, stdout=stream, stderr=stream, text=True
            )

    def processes(self, named: str) -> list[psutil.Process]:
        """Its processes of that name."""
        home = _space(self._pid)
        return [each for each in psutil.process_iter() if named in each.name() and _space(each.pid) == home]

    def cut_off(self) -> None:
        """Let the switch pass on nothing to it or from it any more."""
        _call("ip", "link", "set", self.name, "down")

    def connect(self) -> None:
        """Let the switch pass on all again."""
        _call("ip", "link", "set", self.name, "up")


def _space(pid: int) -> str:
    """The namespace of processes that one lives in; empty for one that has ended."""
    try:
        return os.readlink(f"/proc/{pid}/ns/pid")
    except OSError:
        return ""


def _call(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
