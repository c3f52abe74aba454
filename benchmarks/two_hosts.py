"""td3_bc on two hosts, of which one is cut off and killed: python benchmarks/two_hosts.py [--short].

The hosts are made of namespaces on this machine (`network_hosts`): `first` runs this checkout and learns,
`second` has nothing but the wheel, installed by pip. The run trains across both while `second` is cut off,
comes back, has its raylet killed, and comes back again. Its metrics must be those of one process that nobody
disturbs. Needs the extra ray, and Linux as root, or with namespaces of users. Leaves nothing running.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import psutil
from network_hosts import Host, Network, call_in_namespaces, tell_lack

_ROOT = Path(__file__).resolve().parents[1]
_PACKAGES = ("torchgrasp", "conf", "recipes")
_PORT = 6379
_RAY = "from ray.scripts.scripts import main; main()"
# Ray takes a machine for dead after a minute by default; these are seconds.
_HEALTH = {"initial_delay_ms": 1000, "period_ms": 1000, "timeout_ms": 3000, "failure_threshold": 3}
# Rounds of four episodes, so that both hosts have work; more of them than will be run.
_TRAINING = (
    *("experiment=smoke", "env.num_envs=1", "collector.episodes=4", "total_env_steps=200000"),
    *("objects.num_objects=1", "evaluation.num_objects=1", "evaluation.baselines=[]"),
    *("pretrain.steps=0", "online.critic_warmup=0", "checkpoint.iterations=1000"),
)
_CLOCKED = ("time/", "speed/", "memory/")


class Spent(NamedTuple):
    """What happened, and when: seconds since the start."""

    what: str
    seconds: float


class Trial:
    """Two hosts with Ray, and the run that trains on them.

    Args:
        folder: for all files; a short path, since Ray's sockets lie below it.
        cores: of Ray, on each host.
        limit: seconds for anything that is waited for.
    """

    def __init__(self, folder: Path, *, cores: int, limit: float) -> None:
        self.folder, self.cores, self.limit = folder, cores, limit
        self.events: list[Spent] = []
        self._began = time.monotonic()
        self._python = install_wheel(folder)
        self.tell("the wheel is installed for the second host")
        network = Network(folder)
        hidden = [_ROOT / each for each in (*_PACKAGES, "tests", "benchmarks")]
        self.first, self.second = network.add_host("first"), network.add_host("second", hidden=hidden)
        head = ("--head", f"--port={_PORT}", "--include-dashboard=false", "--no-monitor")
        self._start_ray(self.first, sys.executable, *head)
        self._start_ray(self.second, str(self._python), f"--address={self.address}")
        logs = [self.log(host.name) for host in (self.first, self.second)]
        wait(lambda: all("Ray runtime started" in log.read_text() for log in logs), limit, "Ray ran")
        self.tell("Ray runs on both hosts")

    @property
    def address(self) -> str:
        """Of the cluster."""
        return f"{self.first.address}:{_PORT}"

    def tell(self, what: str) -> None:
        """Note and print an event."""
        self.events.append(Spent(what, time.monotonic() - self._began))
        print(f"{self.events[-1].seconds:6.1f} s  {what}", flush=True)

    def _start_ray(self, host: Host, python: str, *options: str) -> None:
        """Ray on a host, started again whenever it ends, as a service manager would."""
        given = [f"--node-ip-address={host.address}", f"--num-cpus={self.cores}", "--disable-usage-stats"]
        given += [f"--temp-dir={host.folder}/r", "--object-store-memory=200000000", "--block", *options]
        script = 'while true; do "$@"; sleep 1; done'
        command = ["sh", "-c", script, "sh", python, "-c", _RAY, "start", *given]
        host.start(*command, log=self.log(host.name), env=self._environment(host))

    def _environment(self, host: Host) -> dict[str, str]:
        found = "" if host is self.second else str(_ROOT)
        given = {"PYTHONPATH": found, "TORCHGRASP_CACHE": str(host.folder / "cache"), "OMP_NUM_THREADS": "1"}
        return given | {f"RAY_health_check_{name}": str(value) for name, value in _HEALTH.items()}

    def log(self, name: str) -> Path:
        """The file of what a host's Ray, or a run, has written."""
        return self.folder / f"{name}.log"

    def train(self, name: str, *overrides: str) -> Run:
        """Start td3_bc on the first host."""
        output = self.folder / "runs" / name
        command = [sys.executable, str(_ROOT / "recipes" / "td3_bc.py"), *_TRAINING, *overrides]
        command += [f"output_dir={output}"]
        process = self.first.start(*command, log=self.log(name), env=self._environment(self.first))
        return Run(process, self.log(name), output, limit=self.limit)

    def rounds_go_on(self, run: Run, *, count: int = 3) -> None:
        """Wait until more rounds have been learned from."""
        goal = len(run.rows()) + count
        run.wait(lambda: len(run.rows()) >= goal, f"{goal} rounds")


class Run:
    """A run of a recipe on a host.

    Args:
        process: of it.
        log: what it writes.
        output: where its folder lies.
        limit: seconds for anything that is waited for.
    """

    def __init__(self, process: subprocess.Popen[str], log: Path, output: Path, *, limit: float) -> None:
        self.process, self._log, self._output, self._limit = process, log, output, limit

    def said(self, *words: str) -> list[str]:
        """The lines so far that hold all the words."""
        lines = self._log.read_text(errors="replace").splitlines()
        return [line for line in lines if all(word in line for word in words)]

    def rows(self) -> list[dict[str, str]]:
        """The lines of its metrics that do not depend on the clock."""
        found = []
        for file in self._output.glob("*/*/metrics.csv"):
            with file.open() as stream:
                found = list(csv.DictReader(stream))
        whole = [row for row in found if None not in row.values()]
        return [{k: v for k, v in row.items() if not k.startswith(_CLOCKED)} for row in whole]

    def wait(self, ready: Callable[[], object], what: str) -> None:
        """Wait for something; raises RuntimeError where the run ends before, or it takes too long."""
        wait(lambda: ready() or self.process.poll() is not None, self._limit, what)
        if not ready():
            raise RuntimeError(f"the run ended with {self.process.returncode} before {what}")

    def end(self) -> None:
        """Have it save and end, as a scheduler would."""
        for child in psutil.Process(self.process.pid).children():  # what `nsenter` runs
            child.send_signal(signal.SIGTERM)
        self.process.wait(self._limit)


def wait(ready: Callable[[], object], limit: float, what: str) -> None:
    """Look every tenth of a second; raises RuntimeError after `limit` seconds."""
    deadline = time.monotonic() + limit
    while not ready():
        if time.monotonic() > deadline:
            raise RuntimeError(f"{limit:g} s went by before {what}")
        time.sleep(0.1)


def install_wheel(folder: Path) -> Path:
    """The Python of a new environment that has the wheel, and finds all else where this one has it."""
    copy, wheels, home = folder / "copy", folder / "wheels", folder / "venv"
    for each in _PACKAGES:
        shutil.copytree(_ROOT / each, copy / each, ignore=shutil.ignore_patterns("__pycache__"))
    for each in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(_ROOT / each, copy)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    built = ["--no-deps", "--no-build-isolation", f"--wheel-dir={wheels}", str(copy)]
    _call(*pip, "wheel", *built)
    _call(sys.executable, "-m", "venv", "--without-pip", str(home))
    python = home / "bin" / "python"
    (wheel,) = wheels.glob("*.whl")
    _call(*pip, f"--python={python}", "install", "--no-deps", "--no-index", str(wheel))
    (packages,) = home.glob("lib/python*/site-packages")
    # A folder that a .pth file names is searched, but its own .pth files are not read: no checkout is found.
    (packages / "others.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return python


def _call(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}:\n{done.stdout}{done.stderr}")


def disturb(trial: Trial, *, thorough: bool) -> None:
    """The trial itself; raises RuntimeError where a promise is not kept."""
    second = trial.second.address
    workers = 2 * trial.cores
    run = trial.train(
        "both", "collector=ray", f"collector.address={trial.address}", f"collector.num_workers={workers}"
    )

    def came(times: int) -> Callable[[], bool]:
        return lambda: len(run.said(f"on {second}) runs episodes")) >= times * trial.cores

    run.wait(came(1), "the second host runs episodes")
    trial.rounds_go_on(run)
    trial.tell(f"{workers} workers on both hosts, {len(run.rows())} rounds")

    trial.second.cut_off()
    trial.tell("the second host is cut off")
    run.wait(lambda: run.said(second, "was lost"), "its loss was noticed")
    trial.tell(run.said(second, "was lost")[0].partition("Warning: ")[2])
    trial.rounds_go_on(run)
    trial.tell(f"{len(run.rows())} rounds: the first host goes on alone")
    trial.second.connect()
    trial.tell("the second host is connected")
    run.wait(came(2), "the second host is used again")
    trial.rounds_go_on(run)
    trial.tell(f"{len(run.rows())} rounds: the second host is used again")

    lost = len(run.said(second, "was lost"))
    for each in trial.second.processes("raylet"):
        each.kill()
    trial.tell("the second host's raylet is killed")
    run.wait(lambda: len(run.said(second, "was lost")) > lost, "its loss was noticed")
    trial.tell(run.said(second, "was lost")[lost].partition("Warning: ")[2])
    trial.rounds_go_on(run)
    trial.tell(f"{len(run.rows())} rounds: the first host goes on alone")
    if thorough:
        run.wait(came(3), "the second host is used again")
        trial.rounds_go_on(run)
        trial.tell(f"{len(run.rows())} rounds: the second host is used again")
    run.end()
    compare(trial, run)


def compare(trial: Trial, run: Run) -> None:
    """Raise unless one process that nobody disturbs writes the same metrics."""
    disturbed = run.rows()
    alone = trial.train("alone", "collector=serial")
    alone.wait(lambda: len(alone.rows()) >= len(disturbed), f"{len(disturbed)} rounds")
    alone.end()
    if alone.rows()[: len(disturbed)] != disturbed:
        raise RuntimeError("the run on two hosts did not give the metrics of one process")
    trial.tell(f"one process gives the same metrics, all {len(disturbed)} lines")


def main(given: Sequence[str] | None = None) -> None:
    """Make the hosts and run the trial in them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--short", action="store_true", help="one core a host, and no second return")
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)  # of a call from within
    parser.add_argument("--limit", type=float, default=180.0, help="seconds for anything that is waited for")
    chosen = parser.parse_args(given)
    if chosen.folder is None:
        if (lack := tell_lack()) is not None:
            sys.exit(f"No hosts can be made of namespaces: {lack}.")
        with tempfile.TemporaryDirectory(
            prefix="hosts"
        ) as folder:  # removed when all that writes there is gone
            sys.exit(call_in_namespaces(*sys.argv, f"--folder={folder}"))
    try:
        trial = Trial(chosen.folder, cores=1 if chosen.short else 2, limit=chosen.limit)
        disturb(trial, thorough=not chosen.short)
    except (RuntimeError, subprocess.TimeoutExpired) as error:
        logs = (f"\n{log.name}:\n{log.read_text()[-3000:]}" for log in sorted(chosen.folder.glob("*.log")))
        sys.exit(f"{error}{''.join(logs)}")


if __name__ == "__main__":
    main()
