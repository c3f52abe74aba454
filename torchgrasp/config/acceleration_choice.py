"""How a configuration has updates run, where this machine can."""

from __future__ import annotations

import torch
from omegaconf import DictConfig

from torchgrasp.errors import ConfigError
from torchgrasp.training import Acceleration


def make_acceleration(cfg: DictConfig) -> Acceleration:
    """As `compile` and `cudagraphs` say; one line tells of what cannot be had here, which is left out."""
    mode, graphs, device = cfg.compile, cfg.cudagraphs, torch.device(cfg.device)
    if mode == "reduce-overhead" and graphs is True:
        raise ConfigError(
            "compile=reduce-overhead replays CUDA graphs of its own: give compile=default beside "
            "cudagraphs=true, or leave cudagraphs out."
        )
    if mode is not None and (reason := _why_not_compiled(device)) is not None:
        print(f"compile={mode} cannot be had here ({reason}): updates run without it.", flush=True)
        mode = None
    if device.type != "cuda" and graphs is True:
        print(f"cudagraphs=true needs device=cuda, not {cfg.device}: updates run without it.", flush=True)
    if device.type != "cuda" or (graphs == "auto" and mode == "reduce-overhead"):
        graphs = False
    return Acceleration(compile=mode, cudagraphs=graphs, device=device)


def _why_not_compiled(device: torch.device) -> str | None:
    """What torch.compile lacks for the device, if anything: a C++ compiler, and on a GPU Triton."""
    # Loaded where it is asked for alone: it takes seconds.
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch.utils._triton import has_triton

    if device.type == "cuda" and not has_triton():
        return "it needs Triton, which comes with torch, and a GPU that Triton knows"
    try:
        get_cpp_compiler()
    except Exception as error:  # compilers are missing in many ways
        return f"{type(error).__name__}: it needs a C++ compiler such as g++"
    return None
