"""Recipes started as a user would start them, and what their runs leave."""

import csv
import os
import sys
from pathlib import Path

import torch

from tests.configurations import ROOT
from torchgrasp.runs import load_checkpoint, load_weights

_CLOCKED = ("time/", "speed/", "memory/")


def command(name: str, output_dir: Path, *overrides: str) -> list[str]:
    return [sys.executable, str(ROOT / "recipes" / f"{name}.py"), f"output_dir={output_dir}", *overrides]


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}


def find_run(root: Path, recipe: str) -> Path:
    """The only run of a recipe below `root`."""
    (run_dir,) = root.glob(f"{recipe}/*")
    return run_dir


def read_metrics(run_dir: Path) -> list[dict[str, str]]:
    with (run_dir / "metrics.csv").open() as stream:
        return list(csv.DictReader(stream))


def read_results(run_dir: Path) -> list[dict[str, str]]:
    """The metrics that do not depend on how fast the machine is, or when it was interrupted."""
    return [{n: v for n, v in row.items() if not n.startswith(_CLOCKED)} for row in read_metrics(run_dir)]


def stored_rows(run_dir: Path, source: str) -> dict:
    """What the checkpoint's buffer holds of a source."""
    return load_checkpoint(run_dir / "checkpoint")["buffer"]["_storage"]["rows"][source]


def heads_alone_learned(begun: Path, tuned: Path) -> bool:
    """Whether of actor and critic of two runs the encoders are equal and the heads are not."""
    before, after = (load_weights(each / "weights.safetensors")[0] for each in (begun, tuned))
    for name in ("actor", "critic"):
        encoder = [key for key in before[name] if ".encoder." in key]
        heads = [key for key in before[name] if "head" in key]
        assert encoder and heads
        same = [
            all(torch.equal(before[name][key], after[name][key]) for key in keys) for keys in (encoder, heads)
        ]
        if same != [True, False]:
            return False
    return True


def find_processes(mark: str) -> list[str]:
    """Processes that carry the mark TORCHGRASP_TEST_MARK in their environment."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"TORCHGRASP_TEST_MARK={mark}".encode() in entry.read_bytes():
                found.append(entry.parent.name)
        except OSError:
            continue
    return found
