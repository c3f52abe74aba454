"""The moving picture of the closed loop: python docs/pictures/rehearsal.py one.mp4 [file].

The film is that of the benchmark suite=franka with franka.film (docs/deploy.md); needs the extra viz.
"""

from __future__ import annotations

import sys
from pathlib import Path

import imageio_ffmpeg
from contact_sheet import animate
from PIL import Image

_EVERY, _WIDTH = 3, 560  # frame of the film that is kept; pixels


def main(film: Path, path: Path) -> None:
    """Write every third frame of a film, smaller, as an animation at the film's pace."""
    reader = imageio_ffmpeg.read_frames(str(film))
    told = next(reader)
    size = told["size"]
    small = (_WIDTH, round(size[1] * _WIDTH / size[0]))
    frames = [Image.frombytes("RGB", size, data).resize(small) for data in list(reader)[::_EVERY]]
    animate(path, frames, round(1e3 * _EVERY / told["fps"]))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).with_suffix(".webp"))
