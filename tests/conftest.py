"""Tests marked `vulkan` run where something renders; recipes' configurations for all tests."""

import functools
import os

import pytest

from tests.configurations import compose_config
from torchgrasp.sim import RendererProbe, probe_renderer

probe_once = functools.cache(probe_renderer)


def pytest_runtest_setup(item: pytest.Item) -> None:
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
