"""Whether rendering works is found out in a process of its own."""

import pytest

from torchgrasp.sim import probe_renderer


@pytest.mark.vulkan
def test_a_device_that_renders_is_named():
    probe = probe_renderer()
    assert probe.ok and probe.error is None
    assert probe.device
