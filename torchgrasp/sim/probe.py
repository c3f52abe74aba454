"""Whether this machine can render, found out without risk to the process that asks."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

_TIMEOUT = 120.0
# In a process of its own: a failed attempt can leave the renderer unusable, or crash.
_ATTEMPT = """
import json, sapien
system = sapien.render.RenderSystem()
print(json.dumps(system.device.name))
"""
REMEDY = (
    "install a Vulkan driver: the GPU's own, or Mesa's for the CPU, 24.3 or later "
    "(apt-get install mesa-vulkan-drivers libvulkan1; on Debian 12 from bookworm-backports). "
    "The raycast camera needs none."
)


@dataclass(frozen=True)
class RendererProbe:
    """The outcome of an attempt to render.

    Attributes:
        ok: whether it worked.
        device: the device's name, None where it did not work.
        error: what went wrong and what to do, None where it worked.
    """

    ok: bool
    device: str | None
    error: str | None


def probe_renderer() -> RendererProbe:
    """Try SAPIEN's renderer in a process of its own, which takes about a second."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _ATTEMPT], capture_output=True, text=True, timeout=_TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return RendererProbe(False, None, f"The renderer did not start within {_TIMEOUT:.0f} s: {REMEDY}")
    if done.returncode == 0:
        return RendererProbe(True, json.loads(done.stdout.splitlines()[-1]), None)
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    reason = lines[-1] if lines else f"it ended with status {done.returncode}"
    return RendererProbe(False, None, f"SAPIEN's renderer does not start ({reason}): {REMEDY}")
