"""CameraImage: pictures as the input of an image network."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import interpolate
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.transforms.base import CameraName, PointTransform, camera_keys

_CHANNELS = ("rgb", "rgbd", "rgbdm", "d", "dm")


class CameraImage(PointTransform):
    """Stacks a camera's pictures to IMAGE (*, C, size, size), float32.

    Channels in the order of their letters: r, g, b in [0, 1]; d, depth in metres, at most `far`, 0 where
    nothing is seen; m, the target's mask, 0 or 1. A picture of another size is resized: colours by area,
    depth and mask by their nearest pixel, because a depth between two surfaces is on neither.

    Args:
        channels: ``rgb``, ``rgbd`` or ``rgbdm``, which need a camera that renders, or ``d`` or ``dm``.
        size: of the result, pixels.
        far: metres at which depth is cut off.
        camera: whose pictures, wrist or overhead.

    Example:
        >>> from tensordict import TensorDict
        >>> td = TensorDict({"camera": {"depth": torch.ones(8, 8), "mask": torch.ones(8, 8).bool()}})
        >>> CameraImage("dm", size=4)(td)["image"].shape
        torch.Size([2, 4, 4])
    """

    def __init__(
        self, channels: str = "rgbd", *, size: int = 112, far: float = 2.0, camera: CameraName = "wrist"
    ) -> None:
        if channels not in _CHANNELS:
            raise ConfigError(f"channels={channels!r}: give one of {', '.join(_CHANNELS)}.")
        if size < 1:
            raise ConfigError(f"size={size}: give at least 1 pixel.")
        check_range("far", far, 0.0, float("inf"), open_low=True)
        source = camera_keys(camera)
        chosen = {"rgb": source.rgb, "d": source.depth, "m": source.mask}
        super().__init__(
            in_keys=[key for letters, key in chosen.items() if letters in channels], out_keys=[keys.IMAGE]
        )
        self.channels, self.size, self.far, self.camera = channels, size, far, camera

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._check_is_there(set(next_tensordict.keys(True, True)))
        batch_dims = next_tensordict.batch_dims
        planes = [self._planes(next_tensordict.get(key), str(key[1]), batch_dims) for key in self.in_keys]
        image = torch.cat(planes, dim=1)
        next_tensordict.set(keys.IMAGE, image.reshape(*next_tensordict.batch_size, *image.shape[1:]))
        return next_tensordict

    def _planes(self, picture: Tensor, kind: str, batch_dims: int) -> Tensor:
        """One picture of the batch as (B, 3 or 1, size, size)."""
        flat = picture.reshape(-1, *picture.shape[batch_dims:])
        planes = flat.movedim(-1, 1) if kind == "rgb" else flat[:, None]
        planes = planes.to(torch.float32)
        if planes.shape[-2:] != (self.size, self.size):
            planes = interpolate(planes, (self.size,) * 2, mode="area" if kind == "rgb" else "nearest-exact")
        return planes / 255.0 if kind == "rgb" else planes.clamp_max(self.far) if kind == "depth" else planes

    def _check_is_there(self, names: set) -> None:
        for key in self.in_keys:
            if key not in names:
                remedy = (
                    "give the env a RenderCamera" if key[1] == "rgb" else f"give the env a camera {key[0]!r}"
                )
                raise ConfigError(
                    f"CameraImage({self.channels!r}) finds no {key} in the observation: {remedy}."
                )

    def _out_shapes(self, observation_spec: Composite) -> dict:
        self._check_is_there(set(observation_spec.keys(True, True)))
        num_channels = len(self.channels)
        return {keys.IMAGE: ((num_channels, self.size, self.size), torch.float32)}
