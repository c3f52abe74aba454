"""Fully connected stacks, and the checks that the networks share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

from torch import nn

from torchgrasp.errors import ConfigError

Norm = Literal["none", "layer", "batch"]


def mlp(sizes: Sequence[int], *, norm: Norm = "none", last_activation: bool = False) -> nn.Sequential:
    """Linear layers of the given sizes with ReLU between them (Sec. 6.3), and after the last on demand."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), *norm_layers(norm, outputs), nn.ReLU(inplace=True)]
    return nn.Sequential(*(layers if last_activation else layers[: -1 - len(norm_layers(norm, 1))]))


def norm_layers(norm: Norm, channels: int) -> list[nn.Module]:
    """The layers, none or one, that `norm` puts between a linear layer and its activation."""
    if norm == "none":
        return []
    if norm == "layer":
        return [nn.LayerNorm(channels)]
    if norm == "batch":
        return [nn.BatchNorm1d(channels)]
    raise ConfigError(f"norm={norm!r} is unknown: choose 'none', 'layer' or 'batch'.")


def shrink_last_layer(network: nn.Sequential, factor: float) -> None:
    """Scale the last linear layer's weights, so that outputs start near its (zeroed) bias."""
    last = network[-1]
    assert isinstance(last, nn.Linear)
    last.weight.data.mul_(factor)
    last.bias.data.zero_()


def check_channels(in_channels: int) -> None:
    """Raise ConfigError where a cloud of `in_channels` cannot hold x, y and z."""
    if in_channels < 3:
        raise ConfigError(f"in_channels={in_channels} has no room for xyz: give 3 or more.")
