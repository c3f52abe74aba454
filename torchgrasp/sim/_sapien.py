"""Imports sapien without its word that there is no Vulkan: nothing here needs one."""

import warnings

from torchgrasp.errors import MissingPackageError

with warnings.catch_warnings():
    warnings.filterwarnings("ignore", message="Failed to find")
    try:
        import sapien as sapien
    except ImportError as error:
        raise MissingPackageError(
            f"The simulation needs sapien ({error}): pip install sapien; where there is no wheel, as on "
            "arm, take one of SAPIEN's releases on GitHub. Losses, networks and buffers do without."
        ) from error
