"""What a camera is to an arm's loop: anything that can be asked for depth, mask and time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class Picture:
    """One look.

    Attributes:
        depth: (H, W) metres as floats, or millimetres as 16-bit whole numbers; 0 and NaN are holes.
        mask: (H, W), not zero at the target's pixels.
        time: seconds when it was taken, by the clock of the loop.
        joints: (7,) angles of the arm then, rad; None where only those after the picture was read are known.
    """

    depth: np.ndarray
    mask: np.ndarray
    time: float
    joints: np.ndarray | None = None


class DepthCamera(Protocol):
    """A camera, with a segmenter behind it."""

    def read(self) -> Picture:
        """The newest picture; it is not to wait longer than for the next one."""
        ...
