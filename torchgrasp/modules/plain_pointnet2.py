"""PointNet++ as it is usually written in PyTorch: the baseline of `PointNet2`, in values and in speed.

Every row of every ball passes through 1 x 1 convolutions with a graph, coordinates are made relative
before the first, and the ball query sorts all distances. Nothing uses this but tests and
`benchmarks/benchmark.py`.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchgrasp.errors import ConfigError
from torchgrasp.modules.pointnet2 import PointNet2, SetAbstraction


class PlainPointNet2(nn.Module):
    """The plain construction of a PointNet2, with its weights: (B, N, C) clouds to (B, F) features.

    Args:
        encoder: a PointNet2 of norm 'none' or 'batch' that starts at the first or outermost point.

    Example:
        >>> encoder = PointNet2(4, width=0.25)
        >>> clouds = 0.1 * torch.rand(2, 100, 4)
        >>> torch.allclose(PlainPointNet2(encoder)(clouds), encoder(clouds), atol=1e-5)
        True
    """

    def __init__(self, encoder: PointNet2) -> None:
        super().__init__()
        stages = [_PlainAbstraction(stage) for stage in encoder.abstractions]  # pyright: ignore
        self.abstractions = nn.ModuleList(stages)
        self.scale, self.out_features = encoder.scale, encoder.out_features
        self.whole, self.cloud = _convolutions(encoder.whole), _convolutions(encoder.cloud)

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, C) clouds to (B, F) features."""
        xyz, features = points[..., :3], points[..., 3:]
        for abstraction in self.abstractions:
            xyz, features = abstraction(xyz, features)
        rows = torch.cat((xyz / self.scale, features), dim=-1)
        pooled = self.whole(rows.transpose(1, 2)[..., None]).amax(dim=2, keepdim=True)
        return self.cloud(pooled).flatten(1)


class _PlainAbstraction(nn.Module):
    def __init__(self, stage: SetAbstraction) -> None:
        super().__init__()
        self.num_centres, self.radius, self.num_neighbours = (
            stage.num_centres,
            stage.radius,
            stage.num_neighbours,
        )
        self.outermost = stage.start == "outermost"
        self.layers = _convolutions([stage.first, *stage.rest])

    def forward(self, xyz: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        centres = _take(xyz, _farthest(xyz, self.num_centres, outermost=self.outermost))
        distance = (centres[:, :, None] - xyz[:, None]).square().sum(dim=-1)
        distance, index = distance.sort(dim=-1)
        distance, index = distance[..., : self.num_neighbours], index[..., : self.num_neighbours]
        index = torch.where(distance <= self.radius**2, index, index[..., :1])
        offset = (_take(xyz, index) - centres[:, :, None]) / self.radius
        rows = torch.cat((offset, _take(features, index)), dim=-1)  # (B, M, K, C)
        return centres, self.layers(rows.permute(0, 3, 2, 1)).amax(dim=2).transpose(1, 2)


def _farthest(xyz: Tensor, num: int, *, outermost: bool) -> Tensor:
    middle = (xyz.amin(dim=1, keepdim=True) + xyz.amax(dim=1, keepdim=True)) / 2
    last = (xyz - middle).square().sum(dim=-1).argmax(dim=1) * outermost
    nearest = torch.full(xyz.shape[:2], torch.inf, device=xyz.device)
    chosen = [last]
    for _ in range(1, min(num, xyz.shape[1])):
        distance = (xyz - _take(xyz, last[:, None])).square().sum(dim=-1)
        nearest = torch.minimum(nearest, distance)
        last = nearest.argmax(dim=1)
        chosen.append(last)
    return torch.stack(chosen, dim=1)


def _take(values: Tensor, index: Tensor) -> Tensor:
    """(B, N, C) values at (B, ...) indices: (B, ..., C)."""
    clouds = torch.arange(len(values), device=values.device).view(-1, *[1] * (index.ndim - 1))
    return values[clouds, index]


def _convolutions(layers: Sequence[nn.Module] | nn.Sequential) -> nn.Sequential:
    """Linear layers of rows as 1 x 1 convolutions of (B, C, K, M) pictures, with the same weights."""
    return nn.Sequential(*(_convolution(layer) for layer in layers))


def _convolution(layer: nn.Module) -> nn.Module:
    if isinstance(layer, nn.ReLU):
        return nn.ReLU()
    if isinstance(layer, nn.Linear):
        plain = nn.Conv2d(layer.in_features, layer.out_features, 1)
        state = layer.state_dict()
        plain.load_state_dict({"weight": state["weight"][..., None, None], "bias": state["bias"]})
        return plain
    if isinstance(layer, nn.BatchNorm1d):
        plain = nn.BatchNorm2d(layer.num_features)
        plain.load_state_dict(layer.state_dict())
        return plain
    raise ConfigError(f"{type(layer).__name__} has no plain counterpart: give norm 'none' or 'batch'.")
