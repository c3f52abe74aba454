"""PointNet++ (Qi et al. 2017) as the paper's encoder (Sec. 6.3), arranged for speed.

The sizes are the released code's: 32 centres of radius 2 cm, 32 of 4 cm, one global, then 1024 and
512. Three rearrangements leave the function as it is: the first layer of a set abstraction acts on
points before they are grouped, W [x_j - c, f_j] = W [x_j, f_j] - W_x c; a ball takes no more places than
there are points; and only rows that win the max carry a graph (`pooling`; on a GPU kernels of their own
take the rows of balls). `plain_pointnet2.PlainPointNet2` is the same network without them.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.modules.layers import Norm, check_channels, flatten_clouds, mlp, norm_layers
from torchgrasp.modules.pooling import max_over_neighbours, max_over_rows
from torchgrasp.ops import ball_query, farthest_point_sample
from torchgrasp.ops.points import Start, check_start


class SetAbstraction(nn.Module):
    """(B, N, 3) points with (B, N, C) features to (B, M, 3) centres with (B, M, F) features.

    Centres are farthest points; each takes the max of a shared network over the points of its
    ball, whose coordinates enter relative to the centre in units of the radius.

    Args:
        in_features: C, 0 for bare points.
        channels: widths of the shared network; the last is F.
        num_centres: M; where the cloud has no more points than this, each is a centre.
        radius: of the ball, metres.
        num_neighbours: at most so many points of a ball, the nearest ones.
        norm: of the shared network's layers.
        start: where sampling begins, as for `ops.farthest_point_sample`.
    """

    def __init__(
        self,
        in_features: int,
        channels: Sequence[int],
        *,
        num_centres: int,
        radius: float,
        num_neighbours: int,
        norm: Norm = "none",
        start: Start = "outermost",
    ) -> None:
        super().__init__()
        check_range("radius", radius, 0.0, float("inf"), open_low=True)
        check_start(start)
        check_whole("num_centres", num_centres, 1)
        check_whole("num_neighbours", num_neighbours, 1)
        self.num_centres, self.radius, self.num_neighbours = num_centres, radius, num_neighbours
        self.start: Start = start
        self.first = nn.Linear(3 + in_features, channels[0])
        self.rest = nn.Sequential(
            *norm_layers(norm, channels[0]),
            nn.ReLU(inplace=True),
            *mlp(channels, norm=norm, last_activation=True),
        )
        self.rows_are_independent = norm != "batch"

    def forward(self, xyz: Tensor, features: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Positions (B, N, 3), metres, and features (B, N, C) to those of the centres.

        `mask` (B, N) says which rows are points; every centre is one.
        """
        centres = self._centres(xyz, mask)
        index = ball_query(xyz, centres, self.radius, min(self.num_neighbours, xyz.shape[1]), mask=mask)
        points, shift = self._first_layer(xyz, features, centres)
        pooled = max_over_neighbours(self.rest, points, shift, index, independent=self.rows_are_independent)
        return centres, pooled

    def _first_layer(self, xyz: Tensor, features: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
        """W [x, f] + b of every point and W_x c of every centre, whose differences are what follows."""
        with torch.autocast(xyz.device.type, enabled=False):  # the difference would cancel its digits
            dtype = self.first.weight.dtype
            scaled = (xyz / self.radius).to(dtype)
            points = self.first(torch.cat((scaled, features.to(dtype)), dim=-1))
            return points, (centres / self.radius).to(dtype) @ self.first.weight[:, :3].T

    def _centres(self, xyz: Tensor, mask: Tensor | None) -> Tensor:
        if mask is None and xyz.shape[1] <= self.num_centres:
            return xyz
        index = farthest_point_sample(xyz, self.num_centres, mask=mask, start=self.start)
        return xyz.gather(1, index[..., None].expand(-1, -1, 3))


class PointNet2(nn.Module):
    """(*, N, C) clouds to (*, F) features; xyz in metres come first, the other channels are free.

    The order of points does not matter, nor do repeated points as long as no ball holds more points
    than it has places.

    Args:
        in_channels: C, at least 3.
        out_features: F.
        width: multiplies every inner width; 1.0 is the released encoder of 1.4 M parameters.
        norm: 'none', 'layer', 'group' or 'batch'; 'batch' is what the released code has, but its running
            statistics do not follow into target networks that are averaged parameter by parameter, and
            every row then carries a graph.
        centres: how many centres each of the two set abstractions has.
        radii: of their balls, metres.
        neighbours: at most so many points of each ball.
        scale: length in metres that becomes 1 where the last abstraction sees absolute positions.
        start: the first centre: 'outermost', which does not depend on the points' order, 'first', the
            released code's, or 'random', drawn from torch's generator at every pass.

    Example:
        >>> encoder = PointNet2(4, width=0.5)
        >>> encoder(0.1 * torch.rand(2, 262, 4)).shape
        torch.Size([2, 512])
    """

    def __init__(
        self,
        in_channels: int,
        out_features: int = 512,
        *,
        width: float = 1.0,
        norm: Norm = "none",
        centres: Sequence[int] = (32, 32),
        radii: Sequence[float] = (0.02, 0.04),
        neighbours: Sequence[int] = (64, 128),
        scale: float = 0.1,
        start: Start = "outermost",
    ) -> None:
        super().__init__()
        check_channels(in_channels)
        check_whole("out_features", out_features, 1)
        check_range("scale", scale, 0.0, float("inf"), open_low=True)
        _check_pairs(centres=centres, radii=radii, neighbours=neighbours)
        w = _Widths(width)
        self.in_channels, self.out_features, self.scale = in_channels, out_features, scale
        self.rows_are_independent = norm != "batch"
        sizes = ((in_channels - 3, w(64, 64, 128)), (w(128)[0], w(128, 128, 256)))
        self.abstractions = nn.ModuleList(
            SetAbstraction(c, s, num_centres=m, radius=r, num_neighbours=k, norm=norm, start=start)
            for (c, s), m, r, k in zip(sizes, centres, radii, neighbours, strict=True)
        )
        self.whole = mlp((3 + w(256)[0], *w(256, 256, 512)), norm=norm, last_activation=True)
        self.cloud = mlp((*w(512, 1024), out_features), norm=norm, last_activation=True)

    def forward(self, points: Tensor, mask: Tensor | None = None) -> Tensor:
        """(*, N, C) clouds to (*, F) features; `mask` (*, N) bool says which rows are points, all if None.

        A cloud without points is encoded as its first row.
        """
        batch = points.shape[:-2]
        points, mask = flatten_clouds(
            points, mask, self.in_channels, rows_are_independent=self.rows_are_independent
        )
        xyz, features = points[..., :3], points[..., 3:]
        for abstraction in self.abstractions:
            xyz, features = abstraction(xyz, features, mask)
            mask = None  # every centre is a point
        rows = torch.cat(((xyz / self.scale).to(features.dtype), features), dim=-1)
        pooled = max_over_rows(self.whole, rows, independent=self.rows_are_independent)
        return self.cloud(pooled).reshape(*batch, self.out_features)


def _check_pairs(**pairs: Sequence[float]) -> None:
    for name, values in pairs.items():
        if len(values) != 2:
            raise ConfigError(f"{name}={list(values)}: give two, one for each set abstraction.")


class _Widths:
    """The released widths times a factor, at least 1."""

    def __init__(self, factor: float) -> None:
        if not factor > 0:
            raise ConfigError(
                f"width={factor} is not positive: 1.0 is the released encoder, 0.5 half as wide."
            )
        self.factor = factor

    def __call__(self, *channels: int) -> tuple[int, ...]:
        return tuple(max(1, round(self.factor * c)) for c in channels)
