# pyright: reportCallIssue=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
"""Point operations as Triton kernels, compiled when first called. Imported on CUDA devices alone.

A program holds one cloud's coordinates in registers: sampling then reads memory once instead of once a
chosen point, and the ball query writes no (M, N) distances. Fusing multiplications into additions is
switched off, so that distances are those of `definitions` to the bit.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import torch
import triton
import triton.language as tl
from torch import Tensor


def farthest_point_sample(xyz: Tensor, first: Tensor | None, mask: Tensor | None, num: int) -> Tensor:
    """(*, N, 3) clouds and the (*) index to begin with, None for the outermost, to (*, num) int64 indices."""
    points, hidden = _flat(xyz, mask)
    clouds, num_points, _ = points.shape
    index = torch.empty((clouds, num), dtype=torch.int64, device=xyz.device)
    begins = index if first is None else first.reshape(-1).contiguous()
    block = triton.next_power_of_2(num_points)
    with on_device_of(xyz):
        _farthest[(clouds,)](
            *(points, hidden, begins, index, num_points, num, mask is not None, first is None),
            BLOCK=block,
            enable_fp_fusion=False,
            **_launch(block),
        )
    return index.reshape(*xyz.shape[:-2], num)


def ball_query(xyz: Tensor, centres: Tensor, mask: Tensor | None, radius: float, num: int) -> Tensor:
    """(*, N, 3) points and (*, M, 3) centres to (*, M, num) int64 indices."""
    points, hidden = _flat(xyz, mask)
    middle = centres.reshape(-1, *centres.shape[-2:]).float().contiguous()
    (clouds, num_points, _), num_centres = points.shape, middle.shape[1]
    index = torch.empty((clouds, num_centres, num), dtype=torch.int64, device=xyz.device)
    limit = torch.tensor(radius**2, dtype=torch.float32).item()
    block = triton.next_power_of_2(num_points)
    with on_device_of(xyz):
        _ball[(clouds, num_centres)](
            *(points, hidden, middle, index, num_points, num_centres, num, limit, mask is not None),
            BLOCK=block,
            PLACES=triton.next_power_of_2(num),
            enable_fp_fusion=False,
            **_launch(block),
        )
    return index.reshape(*centres.shape[:-1], num)


def _launch(block: int) -> dict[str, int]:
    """A reduction over few points needs no warp but one."""
    return {"num_warps": 1 if block <= 256 else 4}


def on_device_of(xyz: Tensor) -> AbstractContextManager:
    """Triton launches on the current device, whatever the tensors are on."""
    return torch.cuda.device(xyz.device) if xyz.is_cuda else nullcontext()


def _flat(xyz: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor]:
    """Clouds as (B, N, 3) float32, and their masks as (B, N); the points themselves where there is none."""
    points = xyz.reshape(-1, *xyz.shape[-2:]).float().contiguous()
    return points, points if mask is None else mask.reshape(points.shape[:-1]).contiguous()


@triton.jit
def _load_cloud(points, hidden, cloud, num_points, masked: tl.constexpr, BLOCK: tl.constexpr):
    row = tl.arange(0, BLOCK)
    inside = row < num_points
    at = points + (cloud * num_points + row) * 3
    x = tl.load(at, mask=inside, other=0.0)
    y = tl.load(at + 1, mask=inside, other=0.0)
    z = tl.load(at + 2, mask=inside, other=0.0)
    valid = inside
    if masked:
        valid = tl.load(hidden + cloud * num_points + row, mask=inside, other=0).to(tl.int1)
    return row, inside, valid, x, y, z


@triton.jit
def _farthest(
    points,
    hidden,
    first,
    index,
    num_points,
    num,
    masked: tl.constexpr,
    outermost: tl.constexpr,
    BLOCK: tl.constexpr,
):
    cloud = tl.program_id(0).to(tl.int64)
    _row, inside, valid, x, y, z = _load_cloud(points, hidden, cloud, num_points, masked, BLOCK)
    # Padding lies nearer than any point, and what is beyond the cloud nearer than padding.
    behind = tl.where(inside, -1.0, -2.0)
    if outermost:
        dx, dy, dz = x - _middle(x, valid), y - _middle(y, valid), z - _middle(z, valid)
        distance = dx * dx + dy * dy + dz * dz
        # Of NaN nothing is true, and it is as near as padding.
        last = tl.argmax(tl.where(valid & (distance >= 0.0), distance, behind), axis=0).to(tl.int64)
    else:
        last = tl.load(first + cloud)
    tl.store(index + cloud * num, last)
    nearest = tl.where(valid, float("inf"), behind)
    for i in range(1, num):
        at = points + (cloud * num_points + last) * 3
        dx, dy, dz = x - tl.load(at), y - tl.load(at + 1), z - tl.load(at + 2)
        nearest = tl.minimum(nearest, dx * dx + dy * dy + dz * dz)
        last = tl.argmax(nearest, axis=0).to(tl.int64)
        tl.store(index + cloud * num + i, last)


@triton.jit
def _middle(x, valid):
    low, high = tl.where(valid, x, float("inf")), tl.where(valid, x, float("-inf"))
    return (tl.min(low, axis=0) + tl.max(high, axis=0)) / 2


@triton.jit
def _ball(
    points,
    hidden,
    middle,
    index,
    num_points,
    num_centres,
    num,
    limit,
    masked: tl.constexpr,
    BLOCK: tl.constexpr,
    PLACES: tl.constexpr,
):
    cloud = tl.program_id(0).to(tl.int64)
    centre = cloud * num_centres + tl.program_id(1)
    row, _inside, valid, x, y, z = _load_cloud(points, hidden, cloud, num_points, masked, BLOCK)
    at = middle + centre * 3
    dx, dy, dz = x - tl.load(at), y - tl.load(at + 1), z - tl.load(at + 2)
    distance = dx * dx + dy * dy + dz * dz
    distance = tl.where(valid & (distance >= 0.0), distance, float("inf"))  # NaN is nobody's neighbour
    nearest = tl.min(distance, axis=0)
    filler = tl.min(tl.where(distance == nearest, row, BLOCK), axis=0)
    found, k = filler, 0
    while (k < num) & (nearest <= limit):
        tl.store(index + centre * num + k, found.to(tl.int64))
        distance = tl.where(row == found, float("inf"), distance)
        nearest = tl.min(distance, axis=0)
        found = tl.min(tl.where(distance == nearest, row, BLOCK), axis=0)
        k += 1
    place = tl.arange(0, PLACES)
    tl.store(index + centre * num + place, filler.to(tl.int64), mask=(place >= k) & (place < num))
