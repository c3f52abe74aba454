"""The point operations as their definitions say, for one cloud, slow and obvious.

`torchgrasp.ops.points` must agree with these exactly: ties go to the lower index, and distances
are summed as (dx^2 + dy^2) + dz^2 in the cloud's own precision.
"""

from __future__ import annotations

import torch
from torch import Tensor


def squared_distance(points: Tensor, centre: Tensor) -> Tensor:
    """(N, 3) points and a (3,) centre to their (N,) squared distances, m^2."""
    dx, dy, dz = (points - centre).unbind(-1)
    return dx * dx + dy * dy + dz * dz


def farthest_point_sample(xyz: Tensor, num: int) -> Tensor:
    """(N, 3) points, metres, to (num,) indices, each the farthest from all chosen before it.

    The first is index 0. Once every point coincides with a chosen one, index 0 repeats.
    """
    chosen = [0]
    while len(chosen) < num:
        nearest = torch.stack([squared_distance(xyz, xyz[i]) for i in chosen]).amin(dim=0)
        chosen.append(max(range(len(xyz)), key=lambda i: (nearest[i].item(), -i)))
    return torch.tensor(chosen, device=xyz.device)


def ball_query(xyz: Tensor, centres: Tensor, radius: float, num: int) -> Tensor:
    """(N, 3) points and (M, 3) centres, metres, to (M, num) indices of each centre's neighbours.

    Neighbours are the `num` nearest points at most `radius` away, nearest first. Where fewer are
    in the ball, the nearest point of all fills the remaining places, even from outside the ball.
    """
    rows = []
    for centre in centres:
        distance = squared_distance(xyz, centre).tolist()
        order = sorted(range(len(xyz)), key=lambda i: (distance[i], i))
        inside = [i for i in order if distance[i] <= torch.tensor(radius**2, dtype=xyz.dtype).item()][:num]
        rows.append(inside + [order[0]] * (num - len(inside)))
    return torch.tensor(rows, device=xyz.device)


def group(features: Tensor, index: Tensor) -> Tensor:
    """(N, C) features and (M, K) indices to the (M, K, C) features that they name."""
    return torch.stack([torch.stack([features[j] for j in row]) for row in index])
