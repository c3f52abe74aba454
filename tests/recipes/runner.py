"""Recipes started as a user would start them."""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def command(name: str, output_dir: Path, *overrides: str) -> list[str]:
    return [sys.executable, str(ROOT / "recipes" / f"{name}.py"), f"output_dir={output_dir}", *overrides]


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}
