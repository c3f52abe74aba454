"""What an arm is to the loop: a few verbs, whichever robot stands behind them."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Arm(Protocol):
    """An arm with a gripper. Every verb may raise StopError: the arm has stopped, and says why."""

    @property
    def joints(self) -> np.ndarray:
        """(7,) angles, rad."""
        ...

    @property
    def width(self) -> float:
        """Metres between the fingers; NaN where nobody knows."""
        ...

    def follow(self, T_base_ee: np.ndarray, seconds: float) -> None:
        """Set out for a hand pose (4, 4) that is to be reached in `seconds`; returns at once.

        It takes the place of the one before, whose motion is blended into the new one.

        The motion ends there at rest: an arm that is told nothing more stands still.
        """
        ...

    def go(self, T_base_ee: np.ndarray) -> None:
        """Move the hand slowly and straight to a pose (4, 4); returns when it is there."""
        ...

    def grasp(self, force: float) -> None:
        """Wait until the hand has arrived, then close the fingers with a force in newtons."""
        ...

    def open(self) -> None:
        """Open the fingers."""
        ...

    def stop(self) -> None:
        """Bring the arm to rest at once, whatever is under way; raises nothing."""
        ...
