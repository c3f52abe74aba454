"""The operations of `definitions` on whole batches, in torch alone: the path of the CPU, and of any device.

Every function takes any leading dimensions and gives the results of `definitions`, bit for bit.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchgrasp.ops.definitions import wide

_INDEX_BITS = 32


def outermost_point(xyz: Tensor, mask: Tensor | None) -> Tensor:
    """(*, N, 3) clouds to the (*) index of the point farthest from their bounding box's centre."""
    xyz = wide(xyz)
    hidden = None if mask is None else ~mask[..., None]
    low = xyz if hidden is None else xyz.masked_fill(hidden, torch.inf)
    high = xyz if hidden is None else xyz.masked_fill(hidden, -torch.inf)
    centre = (low.amin(dim=-2, keepdim=True) + high.amax(dim=-2, keepdim=True)) / 2
    distance = squared_distance(xyz, centre).squeeze(-2)
    return hide(distance, mask).argmax(dim=-1)


def farthest_point_sample(xyz: Tensor, first: Tensor | None, mask: Tensor | None, num: int) -> Tensor:
    """(*, N, 3) clouds and the (*) index to begin with, None for the outermost, to (*, num) indices."""
    first = outermost_point(xyz, mask) if first is None else first
    xyz = wide(xyz)
    nearest = hide(torch.full(xyz.shape[:-1], torch.inf, dtype=xyz.dtype, device=xyz.device), mask)
    chosen = [first]
    for _ in range(1, num):
        last = chosen[-1][..., None, None].expand(*xyz.shape[:-2], 1, 3)
        distance = squared_distance(xyz, xyz.gather(-2, last)).squeeze(-2)
        nearest = torch.minimum(nearest, distance)
        chosen.append(nearest.argmax(dim=-1))
    return torch.stack(chosen, dim=-1)


def ball_query(xyz: Tensor, centres: Tensor, mask: Tensor | None, radius: float, num: int) -> Tensor:
    """(*, N, 3) points and (*, M, 3) centres to (*, M, num) indices."""
    distance = squared_distance(wide(xyz), wide(centres))
    if mask is not None:
        distance = distance.masked_fill_(~mask[..., None, :], torch.inf)
    index, inside = _nearest(distance, radius, min(num, xyz.shape[-2]))
    index = torch.where(inside, index, index[..., :1])
    padding = index[..., :1].expand(*index.shape[:-1], num - index.shape[-1])
    return torch.cat((index, padding), dim=-1)


def squared_distance(points: Tensor, centre: Tensor) -> Tensor:
    """(*, N, 3) and (*, M, 3) to (*, M, N), m^2. Expanding the square would round otherwise.

    One coordinate at a time: differences as (*, M, N, 3) would be read three times over.
    """
    (x, y, z), (cx, cy, cz) = points.unbind(-1), centre.unbind(-1)
    total = (x[..., None, :] - cx[..., :, None]).square_()
    total += (y[..., None, :] - cy[..., :, None]).square_()
    total += (z[..., None, :] - cz[..., :, None]).square_()
    return total


def hide(distance: Tensor, mask: Tensor | None) -> Tensor:
    """(*, N) distances with padding nearer than any point; the lowest index where there is no point."""
    return distance if mask is None else distance.masked_fill(~mask, -1.0)


def _nearest(distance: Tensor, radius: float, num: int) -> tuple[Tensor, Tensor]:
    """Indices of the `num` smallest of (*, N) squared distances, and which lie within `radius`.

    topk alone leaves ties to chance. A float32 that is not negative orders as its bits do, so the
    index below those bits settles them, at the price of a topk over integers.
    """
    limit = torch.tensor(radius**2, dtype=distance.dtype).item()
    if distance.dtype != torch.float32:
        ordered, index = distance.sort(dim=-1, stable=True)
        return index[..., :num], ordered[..., :num] <= limit
    position = torch.arange(distance.shape[-1], device=distance.device)
    bits = distance.view(torch.int32).long()
    key = bits.bitwise_left_shift_(_INDEX_BITS).bitwise_or_(position)
    key = key.topk(num, dim=-1, largest=False, sorted=True).values
    index = key & ((1 << _INDEX_BITS) - 1)
    return index, distance.gather(-1, index) <= limit
