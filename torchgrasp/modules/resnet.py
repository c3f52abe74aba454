"""ResNet18 (He et al. 2016, table 1): the encoder of the image ablations (Sec. 6.3).

Parameters and buffers carry the names that public ImageNet weights have (``layer1.0.conv1.weight``).
"""

from __future__ import annotations

from collections import OrderedDict
from itertools import pairwise
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.modules.image_weights import load_image_weights
from torchgrasp.modules.layers import GROUP_CHANNELS, warn_of_slow_bfloat16

ImageNorm = Literal["group", "batch", "frozen"]

# Mean and standard deviation of ImageNet's colours, which public weights expect to be taken off.
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class ResNet18(nn.Module):
    """(*, C, H, W) images to (*, F) features; colours in [0, 1] come first, other channels are free.

    Colours are standardised inside; depth in metres, masks and an action beside them enter as they
    are. 11.2 M parameters at width 1.

    Args:
        in_channels: C: 3 for colours, 4 with depth, 5 with the mask; early fusion adds the action's.
        width: multiplies every width, to the nearest multiple of 16; F is 512 times it.
        norm: 'group' (16 channels a group) treats each image alone, so that targets and small batches
            are safe; 'batch' is He et al.'s; 'frozen' has the names of 'batch' and always uses the
            stored statistics: the choice for public weights.
        rgb: whether the first three channels are colours; False for depth and mask alone.
        standardize: take ImageNet's mean off the colours and divide by its standard deviation.
        weights: a local .safetensors file with the parameter names of torchvision and timm. Its
            classifier `fc` is left out; channels that its first layer lacks start at zero.

    Example:
        >>> encoder = ResNet18(4, width=0.25)
        >>> encoder(torch.rand(2, 3, 4, 32, 32)).shape
        torch.Size([2, 3, 128])
    """

    channel_dim = -3
    offset: Tensor
    spread: Tensor

    def __init__(
        self,
        in_channels: int = 3,
        *,
        width: float = 1.0,
        norm: ImageNorm = "group",
        rgb: bool = True,
        standardize: bool = True,
        weights: str | Path | None = None,
    ) -> None:
        super().__init__()
        check_whole("in_channels", in_channels, 1)
        check_range("width", width, 0.0, float("inf"), open_low=True)
        if rgb and in_channels < 3:
            raise ConfigError(
                f"in_channels={in_channels} has no room for red, green and blue: give 3 or more, or "
                "rgb=False for depth and mask alone."
            )
        base = GROUP_CHANNELS * max(1, round(64 * width / GROUP_CHANNELS))
        self.in_channels, self.out_features, self.norm = in_channels, 8 * base, norm
        self.rows_are_independent = norm != "batch"
        self.conv1 = _convolution(in_channels, base, 7, 2)
        self.bn1 = image_norm(norm, base)
        widths = [base * factor for factor in (1, 1, 2, 4, 8)]
        stages = [_stage(inputs, outputs, norm) for inputs, outputs in pairwise(widths)]
        self.layer1, self.layer2, self.layer3, self.layer4 = stages
        colours = 3 if rgb and standardize else 0
        others = in_channels - colours
        for name, values, rest in (("offset", _MEAN, 0.0), ("spread", _STD, 1.0)):
            each = torch.tensor((*values[:colours], *(rest,) * others))
            self.register_buffer(name, each[:, None, None], persistent=False)
        if weights is not None:
            if not rgb:
                raise ConfigError(f"weights={weights} are of colours, which rgb=False says are not there.")
            load_image_weights(self, Path(weights))

    def forward(self, images: Tensor) -> Tensor:
        """(*, C, H, W) images to (*, F) features."""
        _check_images(images, self.in_channels)
        warn_of_slow_bfloat16(images)
        batch = images.shape[:-3]
        rows = images.reshape(-1, *images.shape[-3:])
        rows = self.bn1(self.conv1((rows - self.offset) / self.spread)).relu()
        rows = functional.max_pool2d(rows, 3, stride=2, padding=1)
        for stage in (self.layer1, self.layer2, self.layer3, self.layer4):
            rows = stage(rows)
        return rows.mean(dim=(-2, -1)).reshape(*batch, self.out_features)


class BasicBlock(nn.Module):
    """(B, C, H, W) to (B, F, H', W'): two 3x3 convolutions beside a shortcut; H' is H/2 where F > C.

    Args:
        inputs: C.
        outputs: F.
        norm: as for ResNet18.
    """

    def __init__(self, inputs: int, outputs: int, *, norm: ImageNorm) -> None:
        super().__init__()
        stride = 1 if inputs == outputs else 2
        self.conv1 = _convolution(inputs, outputs, 3, stride)
        self.bn1 = image_norm(norm, outputs)
        self.conv2 = _convolution(outputs, outputs, 3, 1)
        self.bn2 = image_norm(norm, outputs)
        shortcut: OrderedDict[str, nn.Module] = OrderedDict()
        if stride != 1:
            shortcut["0"] = _convolution(inputs, outputs, 1, stride)
            shortcut["1"] = image_norm(norm, outputs)
        self.downsample = nn.Sequential(shortcut)

    def forward(self, images: Tensor) -> Tensor:
        """(B, C, H, W) to (B, F, H', W')."""
        residual = self.bn2(self.conv2(self.bn1(self.conv1(images)).relu()))
        return (residual + self.downsample(images)).relu()


class FrozenBatchNorm2d(nn.BatchNorm2d):
    """BatchNorm by the stored statistics, in training as well; scale and shift still learn."""

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        assert self.running_mean is not None and self.running_var is not None
        scale = self.weight * (self.running_var + self.eps).rsqrt()
        shift = self.bias - self.running_mean * scale
        return input * scale[:, None, None] + shift[:, None, None]


def image_norm(norm: ImageNorm, channels: int) -> nn.Module:
    """The normalisation of that name for images (B, C, H, W)."""
    if norm == "group":
        return nn.GroupNorm(channels // GROUP_CHANNELS, channels)
    if norm == "batch":
        return nn.BatchNorm2d(channels)
    if norm == "frozen":
        return FrozenBatchNorm2d(channels)
    raise ConfigError(f"norm={norm!r} is unknown: choose 'group', 'batch' or 'frozen'.")


def _check_images(images: Tensor, in_channels: int) -> None:
    if images.ndim < 3 or images.shape[-3] != in_channels:
        raise ConfigError(
            f"images of shape {tuple(images.shape)} do not go into an encoder of {in_channels} channels: "
            f"give (*, {in_channels}, H, W)."
        )
    if not images.is_floating_point():
        raise ConfigError(
            f"images of type {images.dtype}: give floating point with colours in [0, 1], bytes divided by "
            "255 (CameraImage does so)."
        )


def _stage(inputs: int, outputs: int, norm: ImageNorm) -> nn.Sequential:
    return nn.Sequential(BasicBlock(inputs, outputs, norm=norm), BasicBlock(outputs, outputs, norm=norm))


def _convolution(inputs: int, outputs: int, size: int, stride: int) -> nn.Conv2d:
    """A convolution without bias that keeps the picture's size but for the stride (He et al. 2015 start)."""
    layer = nn.Conv2d(inputs, outputs, size, stride=stride, padding=size // 2, bias=False)
    nn.init.kaiming_normal_(layer.weight, mode="fan_out", nonlinearity="relu")
    return layer
