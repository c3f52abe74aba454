"""Signals by phase: what each leaves behind, and whether the resumed run ends as if it had not come.

python -m tests.recipes.interruptions                 # all, about ten minutes on two cores
python -m tests.recipes.interruptions imitation INT   # one phase, one signal
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.recipes.runner import command, environment, find_processes, find_run, read_results

GIVEN = ["experiment=smoke", "collector.num_workers=2", "pretrain.steps=100", "total_env_steps=150"]
GIVEN += ["evaluation.episodes=20", "evaluation.baselines=[random]"]
GIVEN += ["checkpoint.steps=1000", "checkpoint.iterations=1000"]
SIGNALS = {"INT": [signal.SIGINT], "TERM": [signal.SIGTERM], "INT twice": 2 * [signal.SIGINT]}
SIGNALS["KILL"] = [signal.SIGKILL]


def exists(pattern: str) -> Callable[[Path, Path], bool]:
    return lambda root, _: any(root.glob(f"td3_bc/*/{pattern}"))


def printed(text: str) -> Callable[[Path, Path], bool]:
    return lambda _, log: text in log.read_text()


# Phase -> whether it has begun, by the run directory's root and by what was printed.
PHASES = {
    "preparation": lambda root, _: any(root.glob("cache/objects/**/*.lock")),
    "demonstrations": exists("demonstrations/card.json"),
    "imitation": exists("metrics.csv"),
    "measurement": printed("imitation: 100/100"),
    "reinforcement": lambda root, _: any(
        "env_steps" in path.read_text() for path in root.glob("td3_bc/*/metrics.csv")
    ),
    "evaluation": printed("reinforcement: "),
    "report": printed("random: 20/20"),
}


def run_to_end(root: Path, *overrides: str) -> Path:
    options = {"env": environment(), "check": True, "capture_output": True, "timeout": 600}
    subprocess.run(command("td3_bc", root, *overrides), **options)  # pyright: ignore[reportCallIssue]
    return find_run(root, "td3_bc")


def interrupt(root: Path, phase: str, signals: Sequence[int]) -> tuple[int, list[str], int]:
    """Exit code, lines printed after the signals, and processes that are left two seconds after the end."""
    log, own = root / "log", {"TORCHGRASP_TEST_MARK": str(root)}
    if phase == "preparation":
        own["TORCHGRASP_CACHE"] = str(root / "cache")
    with log.open("w") as stream:
        process = subprocess.Popen(
            command("td3_bc", root, *GIVEN),
            env={**environment(), **own},
            stdout=stream,
            stderr=stream,
            start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        while not PHASES[phase](root, log) and process.poll() is None:
            time.sleep(0.005)
        before = len(log.read_text().splitlines())
        for number in signals:
            os.killpg(process.pid, number)
            time.sleep(0.02)
        code = process.wait(timeout=120)
    time.sleep(2)
    return code, log.read_text().splitlines()[before:], len(find_processes(str(root)))


def main() -> None:
    wanted_phase, wanted_signal = (*sys.argv[1:3], "", "")[:2]
    with tempfile.TemporaryDirectory() as folder:
        whole = run_to_end(Path(folder, "whole"), *GIVEN)
        print("phase          signal     exit  lines  traceback  left  resumed equal  seconds")
        for phase in PHASES:
            for name, signals in SIGNALS.items():
                if (wanted_phase or phase, wanted_signal or name) != (phase, name):
                    continue
                root = Path(folder, f"{phase}_{name.replace(' ', '_')}")
                root.mkdir()
                began = time.monotonic()
                code, lines, left = interrupt(root, phase, signals)
                seconds = time.monotonic() - began
                run_dir = run_to_end(root, f"resume={find_run(root, 'td3_bc')}")
                equal = read_results(run_dir) == read_results(whole)
                bad = sum("Traceback" in line or "leaked" in line for line in lines)
                row = f"{phase:14} {name:10} {code:4} {len(lines):6} {bad:10} {left:5} {equal!s:>14}"
                print(f"{row} {seconds:8.1f}  {lines[-1] if lines else ''}", flush=True)


if __name__ == "__main__":
    main()
