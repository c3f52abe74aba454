"""PointNet (Qi et al. 2017) without transforms: a shared network per point, max, one layer more."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchgrasp.errors import check_range
from torchgrasp.modules.layers import check_channels, mlp
from torchgrasp.modules.pooling import max_over_rows


class PointNet(nn.Module):
    """(*, N, C) clouds to (*, F) features; xyz in metres come first, the other channels are free.

    Each point enters as its xyz and its xyz relative to the cloud's centroid, both divided by
    `scale`, then its other channels. The order of points and repeated points other than in the
    centroid do not matter.

    Args:
        in_channels: C, at least 3.
        out_features: F.
        hidden: widths of the shared layers; the last is the width that the max pools.
        width: factor of `hidden` and `out_features`.
        scale: length in metres that becomes 1: about the size of an object.

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
    ) -> None:
        super().__init__()
        check_channels(in_channels)
        check_range("scale", scale, 0.0, float("inf"), open_low=True)
        check_range("model.width", width, 0.0, float("inf"), open_low=True)
        hidden = [max(1, round(width * size)) for size in hidden]
        out_features = max(1, round(width * out_features))
        self.in_channels = in_channels
        self.out_features = out_features
        self.scale = scale
        self.points = mlp((in_channels + 3, *hidden), last_activation=True)
        self.cloud = mlp((hidden[-1], out_features), last_activation=True)

    def forward(self, points: Tensor) -> Tensor:
        """(*, N, C) clouds to (*, F) features."""
        batch = points.shape[:-2]
        points = points.reshape(-1, *points.shape[-2:])
        xyz = points[..., :3] / self.scale
        centred = xyz - xyz.mean(dim=-2, keepdim=True)
        rows = torch.cat((xyz, centred, points[..., 3:]), dim=-1)
        return self.cloud(max_over_rows(self.points, rows)).reshape(*batch, self.out_features)
