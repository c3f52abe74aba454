"""How a replay buffer keeps one observation: clouds and features as float16, pictures as bytes."""

from __future__ import annotations

import math
from typing import Literal

import torch
from tensordict import NestedKey
from torch import Tensor

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import gripper_control_points

_NUM_GRIPPER_POINTS = len(gripper_control_points())
_LETTERS = "rgbdm"
_LARGEST = torch.finfo(torch.float16).max


class PlainEncoding:
    """Values as they are."""

    def encode(self, values: Tensor) -> Tensor:
        """The values themselves."""
        return values

    def decode(self, stored: Tensor) -> Tensor:
        """The values themselves."""
        return stored


class CloudEncoding:
    """Clouds (*, N, C) in metres as float16: below 1 m to a quarter of a millimetre.

    With `gripper_points`, the gripper's six points (X_g of Eq. (2)) and the flag channel of
    (*, N + 6, 4), equal in every state, are left out and come back.

    Args:
        key: names the cloud in errors.
        gripper_points: whether the clouds end with the gripper's points and have a flag channel.
    """

    def __init__(self, key: NestedKey, *, gripper_points: bool) -> None:
        self._key, self._gripper_points = key, gripper_points

    def encode(self, values: Tensor) -> Tensor:
        """(R, N + 6, 4) of any floating type to (R, N, 3) float16; or (R, N, C) to the same in float16."""
        if not self._gripper_points:
            return _to_half(values, self._key)
        self._check(values)
        return _to_half(values[..., :-_NUM_GRIPPER_POINTS, :3], self._key)

    def _check(self, points: Tensor) -> None:
        tail = points[..., -_NUM_GRIPPER_POINTS:, :3]
        expected = gripper_control_points().to(tail)
        fits = points.shape[-1] == 4 and tail.shape[-2:] == expected.shape
        if not fits or not torch.allclose(tail, expected.expand_as(tail), atol=1e-4):
            raise ConfigError(
                f"{self._key!r} of shape {tuple(points.shape)} does not end with the gripper's "
                f"{_NUM_GRIPPER_POINTS} points and a flag channel: put AppendGripperPoints after every "
                "transform that moves points, or build CompactTransitions(gripper_points=False)."
            )

    def decode(self, stored: Tensor) -> Tensor:
        """Undo `encode`, up to float16."""
        if not self._gripper_points:
            return stored.float()
        *batch, num_points, _ = stored.shape
        # Spread out while it is half as large, then converted in one piece: a third of the time.
        spread = stored.new_zeros(*batch, num_points + _NUM_GRIPPER_POINTS, 4)
        spread[..., :num_points, :3] = stored
        cloud = spread.float()
        cloud[..., num_points:, :3] = gripper_control_points(device=stored.device)
        cloud[..., num_points:, 3] = 1.0
        return cloud


FeatureType = Literal["float16", "bfloat16", "float32"]


class FeatureEncoding:
    """Features (*) of any shape in a type of fewer bits.

    float16 moves a value by at most 1 / 2,048 of itself (and of those below 6e-5 by 3e-8), bfloat16 by
    1 / 256, float32 not at all. float16 ends at 65,504, and larger values are refused.

    Args:
        key: names the features in errors.
        dtype: that they are stored in.

    >>> encoding = FeatureEncoding("feature", "float16")
    >>> values = torch.rand(4, 3)
    >>> bool(((encoding.decode(encoding.encode(values)) - values).abs() <= values / 2048).all())
    True
    """

    def __init__(self, key: NestedKey, dtype: FeatureType) -> None:
        if dtype not in ("float16", "bfloat16", "float32"):
            raise ConfigError(f"feature_dtype={dtype!r} is unknown: give float16, bfloat16 or float32.")
        self._key, self._dtype = key, getattr(torch, dtype)

    def encode(self, values: Tensor) -> Tensor:
        """(*) of any floating type to (*) of the type stored."""
        stored = values.to(self._dtype)
        if not bool(stored.isfinite().all()):
            raise ConfigError(
                f"{self._key!r} holds values that are NaN, infinite, or too large for {self._dtype}: give "
                "feature_dtype=bfloat16 or float32 where they are but large."
            )
        return stored

    def decode(self, stored: Tensor) -> Tensor:
        """(*) to float32."""
        return stored.float()


class ImageEncoding:
    """Pictures (*, C, H, W) as uint8: colours and mask a byte each, depth the two bytes of a float16.

    Colours that are 255ths, which pictures of a camera are unless they were resized, and masks come
    back exactly; other colours move by at most half a 255th. Depth below 2 m moves by at most 0.5 mm.

    Args:
        key: names the picture in errors.
        channels: a letter for each of the C planes in their order, of r, g, b, d and m.

    >>> image = torch.stack((torch.rand(4, 4), torch.ones(4, 4)))
    >>> encoding = ImageEncoding("image", "dm")
    >>> stored = encoding.encode(image)
    >>> stored.dtype, stored.shape, encoding.decode(stored)[1].unique()
    (torch.uint8, torch.Size([3, 4, 4]), tensor([1.]))
    """

    def __init__(self, key: NestedKey, channels: str) -> None:
        if not channels or set(channels) - set(_LETTERS) or len(set(channels)) < len(channels):
            raise ConfigError(
                f"image_channels={channels!r}: give a letter a plane, each once, of {', '.join(_LETTERS)}."
            )
        self._key, self._channels = key, channels
        self._depth = [place for place, letter in enumerate(channels) if letter == "d"]
        self._others = [place for place, letter in enumerate(channels) if letter != "d"]

    def encode(self, values: Tensor) -> Tensor:
        """(*, C, H, W) float32 to (*, K, H, W) uint8; K is C, and one more where there is depth."""
        if values.shape[-3] != len(self._channels):
            raise ConfigError(
                f"{self._key!r} of shape {tuple(values.shape)} has not the {len(self._channels)} planes of "
                f"image_channels={self._channels!r}: name those that the transform CameraImage writes."
            )
        planes = values[..., self._others, :, :]
        if planes.numel() and not bool(((planes >= 0) & (planes <= 1)).all()):
            raise ConfigError(
                f"{self._key!r} holds colours or masks outside [0, 1]: normalise sampled batches instead, "
                "by the transform= of the buffer."
            )
        parts = [(planes * 255.0).round().to(torch.uint8)]
        if self._depth:
            depth = _to_half(values[..., self._depth[0], :, :], self._key)
            parts.append(depth.view(torch.uint8).reshape(*depth.shape[:-2], 2, *depth.shape[-2:]))
        return torch.cat(parts, dim=-3)

    def decode(self, stored: Tensor) -> Tensor:
        """(*, K, H, W) uint8 to (*, C, H, W) float32."""
        *batch, _, height, width = stored.shape
        image = torch.empty(*batch, len(self._channels), height, width, device=stored.device)
        count = len(self._others)
        image[..., self._others, :, :] = stored[..., :count, :, :].float() / 255.0
        if self._depth:
            depth = stored[..., count:, :, :].contiguous().reshape(*batch, height, 2 * width)
            image[..., self._depth[0], :, :] = depth.view(torch.float16).float()
        return image


def _to_half(values: Tensor, key: NestedKey) -> Tensor:
    """`values` (*) as contiguous float16; ConfigError where one is too large for it, or no number."""
    # Made contiguous first: torch converts strided values one by one.
    half = values.contiguous().half()
    low, high = half.aminmax() if half.numel() else (half.new_zeros(()), half.new_zeros(()))
    if not (float(low) > -math.inf and float(high) < math.inf):
        raise ConfigError(
            f"{key!r} holds values that are NaN, infinite, or beyond the {_LARGEST:.0f} of float16: give "
            "metres, 0 where a camera sees nothing, or keep the key as it is by state_keys."
        )
    return half


Encoding = PlainEncoding | CloudEncoding | ImageEncoding | FeatureEncoding
