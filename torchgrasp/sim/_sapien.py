"""SAPIEN, imported when something of it is first used, so that a policy acts where it is not installed."""

from __future__ import annotations

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from torchgrasp.errors import MissingPackageError
from torchgrasp.sim._lazy import LazyModule


def load_sapien() -> Any:
    """The module itself, imported now."""
    with warnings.catch_warnings():
        # Its word that there is no Vulkan: nothing here needs one.
        warnings.filterwarnings("ignore", message="Failed to find")
        try:
            return importlib.import_module("sapien")
        except ImportError as error:
            raise MissingPackageError(
                f"The simulation needs sapien ({error}): pip install sapien; where there is no wheel, as on "
                "arm, take one of SAPIEN's releases on GitHub. Losses, networks, buffers and GraspAgent do "
                "without."
            ) from error


if TYPE_CHECKING:
    import sapien as sapien
else:
    sapien = LazyModule(load_sapien)
