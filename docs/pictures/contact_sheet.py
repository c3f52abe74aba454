"""Contact sheets, captioned pictures side by side in one file, and animations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchgrasp.report.drawing import write_caption

try:
    import matplotlib
    from PIL import Image
except ImportError as error:
    raise SystemExit('error: pictures need the extra viz: pip install "torchgrasp[viz]"') from error

Tile = tuple[str, np.ndarray]


def sheet(path: Path, tiles: Sequence[Tile], columns: int) -> None:
    """Write captioned pictures of one size as a JPEG, `columns` in a row."""
    drawn = [write_caption(picture, caption, height=28) for caption, picture in tiles]
    drawn += [np.full_like(drawn[0], 255)] * (-len(drawn) % columns)
    rows = [np.hstack(drawn[i : i + columns]) for i in range(0, len(drawn), columns)]
    Image.fromarray(np.vstack(rows)).save(path, quality=82, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def animate(path: Path, frames: Sequence[Image.Image], milliseconds: int | list[int]) -> None:
    """Write pictures of one size as a WebP that begins again at its end, each shown for so long."""
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=milliseconds, loop=0, quality=55, method=6
    )
    print(f"{path}: {len(frames)} frames, {path.stat().st_size / 1e3:.0f} kB")


def coloured(depth: np.ndarray) -> np.ndarray:
    """Depth (H, W), near in yellow and far in blue, nothing in black."""
    near, far = depth[depth > 0].min(), depth.max()
    shades = matplotlib.colormaps["viridis_r"]((depth - near) / (far - near))[..., :3]
    return (255 * np.where(depth[..., None] > 0, shades, 0)).astype(np.uint8)
