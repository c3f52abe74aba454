"""The operations of `reference`, batched over any leading dimensions, with the same results."""

from __future__ import annotations

import torch
from torch import Tensor

from torchgrasp.errors import ConfigError

_INDEX_BITS = 32


def _squared_distance(points: Tensor, centre: Tensor) -> Tensor:
    """(*, N, 3) and (*, M, 3) to (*, M, N), m^2. Expanding the square would round otherwise than `reference`.

    One coordinate at a time: differences as (*, M, N, 3) would be read three times over.
    """
    (x, y, z), (cx, cy, cz) = points.unbind(-1), centre.unbind(-1)
    total = (x[..., None, :] - cx[..., :, None]).square_()
    total += (y[..., None, :] - cy[..., :, None]).square_()
    total += (z[..., None, :] - cz[..., :, None]).square_()
    return total


def farthest_point_sample(xyz: Tensor, num: int) -> Tensor:
    """(*, N, 3) points, metres, to (*, num) int64 indices, each the farthest from all before it.

    Deterministic: starts at index 0, ties go to the lower index; once every point coincides with a
    chosen one, index 0 repeats.

    Example:
        >>> line = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 0, 0]])
        >>> farthest_point_sample(line, 3)
        tensor([0, 3, 2])
    """
    if xyz.shape[-2] == 0 or num < 1:
        raise ConfigError(f"cannot choose {num} of {xyz.shape[-2]} points: give both at least one.")
    with torch.no_grad():
        return _farthest(xyz.detach(), num)


def _farthest(xyz: Tensor, num: int) -> Tensor:
    index = torch.zeros((*xyz.shape[:-2], num), dtype=torch.long, device=xyz.device)
    nearest = torch.full(xyz.shape[:-1], torch.inf, dtype=xyz.dtype, device=xyz.device)
    for i in range(1, num):
        last = index[..., i - 1, None, None].expand(*xyz.shape[:-2], 1, 3)
        nearest = torch.minimum(nearest, _squared_distance(xyz, xyz.gather(-2, last)).squeeze(-2))
        index[..., i] = nearest.argmax(dim=-1)
    return index


def ball_query(xyz: Tensor, centres: Tensor, radius: float, num: int) -> Tensor:
    """(*, N, 3) points and (*, M, 3) centres, metres, to (*, M, num) int64 indices of neighbours.

    Neighbours are the `num` nearest points at most `radius` metres away, nearest first, ties to the
    lower index. Where fewer are in the ball, the nearest point of all fills the remaining places,
    even from outside the ball: a centre that is one of the points is always in its own ball.

    Example:
        >>> line = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 0, 0]])
        >>> ball_query(line, line[[1, 3]], radius=1.0, num=4)
        tensor([[1, 0, 2, 1],
                [3, 3, 3, 3]])
    """
    with torch.no_grad():
        distance = _squared_distance(xyz, centres)
        index, inside = _nearest(distance, radius, min(num, xyz.shape[-2]))
        index = torch.where(inside, index, index[..., :1])
        padding = index[..., :1].expand(*index.shape[:-1], num - index.shape[-1])
        return torch.cat((index, padding), dim=-1)


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
    bits = distance.contiguous().view(torch.int32).long()
    key = bits.bitwise_left_shift_(_INDEX_BITS).bitwise_or_(position)
    key = key.topk(num, dim=-1, largest=False, sorted=True).values
    index = key & ((1 << _INDEX_BITS) - 1)
    return index, distance.gather(-1, index) <= limit


def group(features: Tensor, index: Tensor) -> Tensor:
    """(*, N, C) features and (*, M, K) indices to the (*, M, K, C) features that they name.

    Example:
        >>> group(torch.tensor([[5.0], [6.0]]), torch.tensor([[1, 0], [1, 1]])).squeeze(-1)
        tensor([[6., 5.],
                [6., 6.]])
    """
    channels = features.shape[-1]
    flat = index.flatten(-2)[..., None].expand(*index.shape[:-2], -1, channels)
    return features.gather(-2, flat).unflatten(-2, index.shape[-2:])
