"""PointNet (Qi et al. 2017) without transforms: a shared network per point, max, one layer more."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.modules.layers import Norm, check_channels, flatten_clouds, mlp
from torchgrasp.modules.pooling import max_over_rows


class PointNet(nn.Module):
    """(*, N, C) clouds to (*, F) features; xyz in metres come first, the other channels are free.

    Each point enters as its xyz and its xyz relative to the cloud's centroid, both divided by
    `scale`, then its other channels. The order of points does not matter; repeated points move the
    centroid and change nothing else.

    Args:
        in_channels: C, at least 3.
        out_features: F.
        hidden: widths of the shared layers; the last is the width that the max pools.
        width: factor of `hidden` and `out_features`.
        scale: length in metres that becomes 1: about the size of an object.
        norm: of the shared layers and the last: 'none', 'layer', 'group' or 'batch' (see PointNet2).

    Example:
        >>> encoder = PointNet(4)
        >>> encoder(torch.rand(2, 5, 262, 4)).shape
        torch.Size([2, 5, 256])
    """

    def __init__(
        self,
        in_channels: int,
        out_features: int = 256,
        *,
        hidden: Sequence[int] = (64, 128, 256),
        width: float = 1.0,
        scale: float = 0.1,
        norm: Norm = "none",
    ) -> None:
        super().__init__()
        check_channels(in_channels)
        check_range("scale", scale, 0.0, float("inf"), open_low=True)
        check_range("width", width, 0.0, float("inf"), open_low=True)
        check_whole("out_features", out_features, 1)
        if not hidden:
            raise ConfigError("hidden=() names no layer: give widths, such as (64, 128, 256).")
        hidden = [max(1, round(width * size)) for size in hidden]
        out_features = max(1, round(width * out_features))
        self.in_channels = in_channels
        self.out_features = out_features
        self.scale = scale
        self.rows_are_independent = norm != "batch"
        self.points = mlp((in_channels + 3, *hidden), norm=norm, last_activation=True)
        self.cloud = mlp((hidden[-1], out_features), norm=norm, last_activation=True)

    def forward(self, points: Tensor, mask: Tensor | None = None) -> Tensor:
        """(*, N, C) clouds to (*, F) features; `mask` (*, N) bool says which rows are points, all if None.

        A cloud without points is encoded as its first row.
        """
        batch = points.shape[:-2]
        points, mask = flatten_clouds(
            points, mask, self.in_channels, rows_are_independent=self.rows_are_independent
        )
        xyz = points[..., :3] / self.scale
        rows = torch.cat((xyz, xyz - _centroid(xyz, mask), points[..., 3:]), dim=-1)
        pooled = max_over_rows(self.points, rows, independent=self.rows_are_independent)
        return self.cloud(pooled).reshape(*batch, self.out_features)


def _centroid(xyz: Tensor, mask: Tensor | None) -> Tensor:
    """Mean of the points of each (B, N, 3) cloud, (B, 1, 3); of all rows where none is a point."""
    if mask is None:
        return xyz.mean(dim=-2, keepdim=True)
    counted = (mask | ~mask.any(dim=-1, keepdim=True))[..., None]
    return (xyz * counted).sum(dim=-2, keepdim=True) / counted.sum(dim=-2, keepdim=True)
