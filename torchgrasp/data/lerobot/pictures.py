"""Pictures of a camera as files inside parquet, bit for bit: depth as TIFF of floats, the rest as PNG."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchgrasp.data.lerobot.features import PictureKind
from torchgrasp.errors import ConfigError

_FORMATS = ("PNG", "TIFF", "JPEG")
# TIFF's tag for how a pixel is told by its neighbour, and the way made for floats.
_PREDICTOR, _FLOATS = 317, 3
_SHORTS = ("I;16", "I;16L", "I;16B")
_SMALLEST_MASK = 128


def encode_picture(values: Tensor, kind: PictureKind) -> bytes:
    """One picture to a file: depth (H, W) float32, a mask (H, W) bool, or colours (H, W, 3) uint8."""
    from PIL import Image

    file = BytesIO()
    if kind == "depth":
        options: dict[str, Any] = {"compression": "tiff_adobe_deflate", "tiffinfo": {_PREDICTOR: _FLOATS}}
        Image.fromarray(values.numpy()).save(file, "TIFF", **options)
    else:
        plain = values.to(torch.uint8) * 255 if kind == "mask" else values
        Image.fromarray(plain.numpy()).save(file, "PNG")
    return file.getvalue()


def decode_pictures(
    files: Sequence[bytes | None],
    name: str,
    kind: PictureKind,
    *,
    shape: tuple[int, ...],
    unit: str | None = None,
) -> Tensor:
    """Files to pictures (T, *shape), of the types that `encode_picture` takes.

    ConfigError with `name` where one is missing, no picture, of another size or mode.

    Args:
        files: what one frame after the other holds.
        name: of episode and feature, for errors.
        kind: of picture.
        shape: (H, W) or (H, W, 3).
        unit: of depth, m or mm; None for metres where it is stored in floats, else millimetres.
    """
    read = {"depth": _read_depth, "mask": _read_mask, "rgb": _read_colours}[kind]
    pictures = [_decode(file, name, read, shape) for file in files]
    value = torch.from_numpy(np.stack(pictures))
    if kind != "depth":
        return value
    if not bool(value.isfinite().all()):
        raise ConfigError(f"{name} holds depths that are no numbers: give 0 where nothing is seen.")
    thousandths = unit == "mm" or (unit is None and pictures[0].dtype != np.float32)
    return (value.double() / 1000.0).float() if thousandths else value.float()


def _decode(file: bytes | None, name: str, read: Callable, shape: tuple[int, ...]) -> Any:
    from PIL import Image

    try:
        if not file:
            raise ValueError("there is no picture inside the dataset's own files")
        with Image.open(BytesIO(file), formats=_FORMATS) as image:
            # The header alone is read so far: what is too large takes no memory.
            if image.size != (shape[1], shape[0]):
                raise ValueError(f"it has {image.size[1]} x {image.size[0]} pixels, not {shape[:2]}")
            return read(image)
    except Exception as error:  # Pillow raises whatever its formats' readers do
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigError(f"{name} holds a picture that cannot be used ({reason}): mend it.") from error


def _read_depth(image: Any) -> Any:
    if image.mode == "F":
        return np.array(image, dtype=np.float32)
    if image.mode not in (*_SHORTS, "I"):
        raise ValueError(f"mode {image.mode}, expected depth in 16 or 32 bits of one channel")
    return np.array(image).astype(np.int32)


def _read_mask(image: Any) -> Any:
    if image.mode not in ("1", "L", "RGB"):
        raise ValueError(f"mode {image.mode}, expected a mask in black and white")
    return np.array(image.convert("L")) >= _SMALLEST_MASK


def _read_colours(image: Any) -> Any:
    if image.mode != "RGB":
        raise ValueError(f"mode {image.mode}, expected RGB")
    return np.array(image)
