"""MuJoCo, imported when something of it is first used, so that all else works where it is not installed."""

from __future__ import annotations

import importlib
from typing import Any

from torchgrasp.errors import MissingPackageError
from torchgrasp.sim._lazy import LazyModule


def load_mujoco() -> Any:
    """The module itself, imported now."""
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise MissingPackageError(
            f'engine=mujoco needs mujoco ({error}): pip install "torchgrasp[mujoco]", or give engine=sapien.'
        ) from error


mujoco: Any = LazyModule(load_mujoco)  # its stubs leave out what it exports
