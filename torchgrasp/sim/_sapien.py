"""Imports sapien without its word that there is no Vulkan: nothing here needs one."""

import warnings

with warnings.catch_warnings():
    warnings.filterwarnings("ignore", message="Failed to find")
    import sapien as sapien
