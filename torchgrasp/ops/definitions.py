"""The point operations as their definitions say, for one cloud, slow and obvious.

`torchgrasp.ops` must agree with these exactly: ties go to the lower index, and distances are summed as
(dx^2 + dy^2) + dz^2, in float32 where coordinates are of a lower precision. `mask` says which rows of a
cloud are points and which are padding.
"""

from __future__ import annotations

import torch
from torch import Tensor


def wide(xyz: Tensor) -> Tensor:
    """Coordinates in the precision that distances are computed in: at least float32."""
    return xyz.float() if xyz.dtype.itemsize < 4 else xyz


def squared_distance(points: Tensor, centre: Tensor) -> Tensor:
    """(N, 3) points and a (3,) centre to their (N,) squared distances, m^2."""
    dx, dy, dz = (wide(points) - wide(centre)).unbind(-1)
    return dx * dx + dy * dy + dz * dz


def outermost_point(xyz: Tensor, mask: Tensor | None = None) -> int:
    """Index of the point farthest from the centre of the (N, 3) cloud's bounding box; 0 of no points."""
    valid = _valid(xyz, mask)
    if not valid:
        return 0
    points = wide(xyz)[valid]
    distance = squared_distance(points, (points.amin(dim=0) + points.amax(dim=0)) / 2).tolist()
    return max(zip(distance, [-i for i in valid], strict=True))[1] * -1


def farthest_point_sample(xyz: Tensor, num: int, first: int, mask: Tensor | None = None) -> Tensor:
    """(N, 3) points, metres, to (num,) indices, each the farthest from all chosen before it.

    Once every point coincides with a chosen one, the point of the lowest index repeats. A cloud without
    points gives index 0 throughout.
    """
    valid = _valid(xyz, mask)
    chosen = [first]
    while len(chosen) < num:
        nearest = torch.stack([squared_distance(xyz, xyz[i]) for i in chosen]).amin(dim=0).tolist()
        chosen.append(max(valid, key=lambda i: (nearest[i], -i)) if valid else 0)
    return torch.tensor(chosen, device=xyz.device)


def ball_query(xyz: Tensor, centres: Tensor, radius: float, num: int, mask: Tensor | None = None) -> Tensor:
    """(N, 3) points and (M, 3) centres, metres, to (M, num) indices of each centre's neighbours.

    Neighbours are the `num` nearest points at most `radius` away, nearest first. Where fewer are in the
    ball, the nearest point of all fills the remaining places, even from outside the ball. A cloud
    without points gives index 0 throughout.
    """
    valid = _valid(xyz, mask) or [0]
    limit = torch.tensor(radius**2, dtype=wide(xyz).dtype).item()
    rows = []
    for centre in centres:
        distance = squared_distance(xyz, centre).tolist()
        order = sorted(valid, key=lambda i: (distance[i], i))
        inside = [i for i in order if distance[i] <= limit][:num]
        rows.append(inside + [order[0]] * (num - len(inside)))
    return torch.tensor(rows, device=xyz.device)


def group(features: Tensor, index: Tensor) -> Tensor:
    """(N, C) features and (M, K) indices to the (M, K, C) features that they name."""
    return torch.stack([torch.stack([features[j] for j in row]) for row in index])


def _valid(xyz: Tensor, mask: Tensor | None) -> list[int]:
    return [i for i in range(len(xyz)) if mask is None or mask[i]]
