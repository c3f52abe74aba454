"""The versions that results depend on."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import torchgrasp

_PACKAGES = ("torch", "torchrl", "tensordict", "sapien", "numpy", "embreex")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on; those not installed left out."""
    # From the package itself: a checkout's metadata may be of an earlier installation.
    found = {"python": platform.python_version(), "torchgrasp": torchgrasp.__version__}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
