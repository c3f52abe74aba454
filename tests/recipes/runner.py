"""Recipes started as a user would start them."""

import os
import sys
from pathlib import Path

import torch

from torchgrasp.runs.weights import load_weights

ROOT = Path(__file__).parents[2]


def command(name: str, output_dir: Path, *overrides: str) -> list[str]:
    return [sys.executable, str(ROOT / "recipes" / f"{name}.py"), f"output_dir={output_dir}", *overrides]


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}


def assert_heads_alone_learned(begun: Path, tuned: Path) -> None:
    """Of actor and critic of two runs, encoders are equal and heads are not."""
    before, after = (load_weights(each / "weights.safetensors")[0] for each in (begun, tuned))
    for name in ("actor", "critic"):
        encoder = [key for key in before[name] if ".encoder." in key]
        heads = [key for key in before[name] if "head" in key]
        assert encoder and heads
        assert all(torch.equal(before[name][key], after[name][key]) for key in encoder)
        assert not all(torch.equal(before[name][key], after[name][key]) for key in heads)
