"""Fully connected stacks, and the checks that the networks share."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor, nn

from torchgrasp.errors import ConfigError

Norm = Literal["none", "layer", "group", "batch"]

# Wu and He 2018 found 16 channels a group to serve as well as 32 groups.
GROUP_CHANNELS = 16


def mlp(sizes: Sequence[int], *, norm: Norm = "none", last_activation: bool = False) -> nn.Sequential:
    """Linear layers of the given sizes with ReLU between them (Sec. 6.3), and after the last on demand."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), *norm_layers(norm, outputs), nn.ReLU(inplace=True)]
    return nn.Sequential(*(layers if last_activation else layers[: -1 - len(norm_layers(norm, 1))]))


def norm_layers(norm: Norm, channels: int) -> list[nn.Module]:
    """The layers, none or one, that `norm` puts between a linear layer and its activation.

    Groups have 16 channels, or the next larger number that divides `channels`.
    """
    if norm == "none":
        return []
    if norm == "layer":
        return [nn.LayerNorm(channels)]
    if norm == "group":
        sizes = range(min(GROUP_CHANNELS, channels), channels + 1)
        return [RowGroupNorm(channels // next(n for n in sizes if channels % n == 0), channels)]
    if norm == "batch":
        return [nn.BatchNorm1d(channels)]
    raise ConfigError(f"norm={norm!r} is unknown: choose 'none', 'layer', 'group' or 'batch'.")


class RowGroupNorm(nn.GroupNorm):
    """GroupNorm of each row by itself: (*, C) to (*, C)."""

    def forward(self, rows: Tensor) -> Tensor:
        """Normalise the groups of channels of every row."""
        return super().forward(rows.flatten(0, -2)).view(rows.shape)


def warn_of_slow_bfloat16(inputs: Tensor) -> None:
    """Warn, once, where products will be bfloat16 on a CPU that has no instructions for them."""
    if inputs.device.type != "cpu" or torch.compiler.is_compiling():
        return
    low = torch.is_autocast_enabled("cpu") and torch.get_autocast_dtype("cpu") == torch.bfloat16
    if low or inputs.dtype == torch.bfloat16:
        _warn_of_slow_bfloat16()


@functools.cache
def _warn_of_slow_bfloat16() -> None:
    if torch.backends.mkldnn.is_available() and not torch.ops.mkldnn._is_mkldnn_bf16_supported():
        warnings.warn(
            "This CPU has no bfloat16 arithmetic: float32, without autocast, is about ten times as fast.",
            stacklevel=4,
        )


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


def flatten_clouds(
    points: Tensor, mask: Tensor | None, in_channels: int, *, rows_are_independent: bool
) -> tuple[Tensor, Tensor | None]:
    """Clouds (*, N, C) as (B, N, C), their masks (*, N) as (B, N), padding replaced by a point.

    Copies of the first point stand where the mask is false, so that nothing in the padding, NaN
    included, reaches values or gradients.
    """
    if points.ndim < 2 or points.shape[-1] != in_channels or points.shape[-2] == 0:
        raise ConfigError(
            f"clouds of shape {tuple(points.shape)} do not go into an encoder of {in_channels} channels: "
            f"give (*, N, {in_channels}) with N at least 1."
        )
    warn_of_slow_bfloat16(points)
    flat = points.reshape(-1, *points.shape[-2:])
    if mask is None:
        return flat, None
    if mask.dtype != torch.bool or mask.shape != points.shape[:-1]:
        raise ConfigError(
            f"mask {tuple(mask.shape)} {mask.dtype}: give bool of shape {tuple(points.shape[:-1])}."
        )
    if not rows_are_independent:
        raise ConfigError("norm='batch' would count the rows that a mask hides: choose another norm.")
    mask = mask.reshape(flat.shape[:-1])
    first = mask.int().argmax(dim=-1)[:, None, None].expand(-1, 1, flat.shape[-1])
    return torch.where(mask[..., None], flat, flat.gather(1, first)), mask
