"""Tests marked `vulkan` or `pybullet` run where there is such a thing; recipes' configurations for all."""

import functools
import importlib.util
import os
import sys

import pytest

from tests.configurations import compose_config
from torchgrasp.sim import RendererProbe, probe_renderer

probe_once = functools.cache(probe_renderer)


def pytest_runtest_setup(item: pytest.Item) -> None:
    absent = sys.version_info >= (3, 12) and importlib.util.find_spec("pybullet_data") is None
    if absent and item.get_closest_marker("pybullet") is not None:
        pytest.skip("pybullet is not installed, and has no wheel for this Python")
    if item.get_closest_marker("vulkan") is None:
        return
    probe: RendererProbe = probe_once()
    if probe.ok:
        return
    if os.environ.get("TORCHGRASP_REQUIRE_VULKAN") == "1":
        pytest.fail(f"TORCHGRASP_REQUIRE_VULKAN=1, but {probe.error}")
    pytest.skip(str(probe.error))


@pytest.fixture
def composed(tmp_path):
    """Composes a recipe's configuration with overrides, its output below tmp_path."""
    return functools.partial(compose_config, f"output_dir={tmp_path}")
