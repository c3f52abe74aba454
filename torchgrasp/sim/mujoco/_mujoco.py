"""MuJoCo, imported when something of it is first used, so that all else works where it is not installed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from torchgrasp.errors import MissingPackageError

if TYPE_CHECKING:
    import mujoco as mujoco
else:

    class _Mujoco:
        """The module's attributes by their names."""

        def __getattr__(self, name: str) -> Any:
            found = getattr(load_mujoco(), name)
            setattr(self, name, found)
            return found

    mujoco = _Mujoco()


def load_mujoco() -> Any:
    """The module itself, imported now."""
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise MissingPackageError(
            f'engine=mujoco needs mujoco ({error}): pip install "torchgrasp[mujoco]", or give engine=sapien.'
        ) from error
