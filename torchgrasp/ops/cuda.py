"""Whether Triton kernels work on a device: tried once, and those of `kernels` against `dense`."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from types import ModuleType

import torch
from torch import Tensor

from torchgrasp.ops import dense

# Rows of a cloud that one program of a kernel holds in its registers.
MAX_POINTS = 8192


def cuda_kernels(xyz: Tensor) -> ModuleType | None:
    """The module of kernels where it serves these (*, N, 3) points, else None."""
    if xyz.device.type != "cuda" or xyz.dtype == torch.float64 or xyz.shape[-2] > MAX_POINTS:
        return None
    return _tried_kernels(xyz.device)


@functools.cache
def _tried_kernels(device: torch.device) -> ModuleType | None:
    """The kernels, if what they say of a small cloud on this device is what `dense` says."""

    def check() -> None:
        from torchgrasp.ops import kernels

        check_against_dense(kernels, device)

    if not succeeds(check, "point kernels", device, instead="slower torch operations"):
        return None
    from torchgrasp.ops import kernels

    return kernels


def succeeds(check: Callable[[], None], what: str, device: torch.device, *, instead: str) -> bool:
    """Whether a check of kernels passes; a warning says where it does not, and what takes their place."""
    try:
        check()
    except Exception as error:  # Triton needs a C compiler and fails in many ways
        warnings.warn(
            f"torchgrasp's {what} do not work on {device} ({type(error).__name__}: {error}); {instead} take "
            "their place. They need Triton, which comes with torch, and a C compiler.",
            stacklevel=3,
        )
        return False
    return True


def check_against_dense(kernels: ModuleType, device: torch.device) -> None:
    """Raise ValueError where the kernels differ from `dense` on clouds that provoke ties."""
    generator = torch.Generator().manual_seed(0)
    xyz = torch.randint(0, 7, (3, 50, 3), generator=generator).float().mul_(0.01)
    xyz[1] += 0.001 * torch.rand(50, 3, generator=generator)
    mask = torch.rand(3, 50, generator=generator) < 0.8
    xyz, mask = xyz.to(device), mask.to(device)
    for valid in (None, mask):
        first = dense.outermost_point(xyz, valid)
        index = dense.farthest_point_sample(xyz, first, valid, 9)
        centres = xyz.gather(1, index[..., None].expand(-1, -1, 3))
        pairs = (
            (kernels.farthest_point_sample(xyz, first, valid, 9), index),
            (kernels.farthest_point_sample(xyz, None, valid, 9), index),
            (
                kernels.ball_query(xyz, centres, valid, 0.02, 6),
                dense.ball_query(xyz, centres, valid, 0.02, 6),
            ),
        )
        if not all(torch.equal(found, expected) for found, expected in pairs):
            raise ValueError("they choose other points")
