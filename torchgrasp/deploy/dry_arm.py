"""An arm that only says what it would do: the first run on a new cell."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from torchgrasp.sim.kinematics import forward_kinematics


class DryArm:
    """Prints each command instead of moving; needs no robot and no franky. An `Arm`.

    It stands where it is told to stand: every command is the answer to the picture from there.

    Args:
        joints: (7,) angles, rad, of the arm that the camera belongs to, or a function that reads them.
        write: takes a line.

    Example:
        >>> from torchgrasp.sim.kinematics import READY_POSTURE
        >>> arm = DryArm(READY_POSTURE)
        >>> hand = forward_kinematics(READY_POSTURE[None])[0]
        >>> hand[2, 3] -= 0.02
        >>> arm.follow(hand, 0.15)
        hand to x 0.615, y 0.000, z 0.253 m: 20 mm and 0 degrees away
    """

    def __init__(self, joints: Any, *, write: Callable[[str], object] = print) -> None:
        self._read: Callable[[], Any] = joints if callable(joints) else lambda: joints
        self._write = write

    @property
    def joints(self) -> np.ndarray:
        """See `Arm.joints`."""
        return np.asarray(self._read(), dtype=np.float64)[:7]

    @property
    def width(self) -> float:
        """NaN: nothing is closed."""
        return float("nan")

    def follow(self, T_base_ee: np.ndarray, seconds: float) -> None:
        """See `Arm.follow`."""
        self._write(f"hand to {self._tell(T_base_ee)}")

    def go(self, T_base_ee: np.ndarray) -> None:
        """See `Arm.go`."""
        self._write(f"slowly to {self._tell(T_base_ee)}")

    def grasp(self, force: float) -> None:
        """See `Arm.grasp`."""
        self._write(f"close the fingers with {force:g} N")

    def open(self) -> None:
        """See `Arm.open`."""
        self._write("open the fingers")

    def stop(self) -> None:
        """See `Arm.stop`."""
        self._write("stop")

    def _tell(self, T_base_ee: np.ndarray) -> str:
        here = forward_kinematics(self.joints[None])[0]
        way = 1000 * float(np.linalg.norm(T_base_ee[:3, 3] - here[:3, 3]))
        turn = np.degrees(Rotation.from_matrix(here[:3, :3].T @ T_base_ee[:3, :3]).magnitude())
        x, y, z = (T_base_ee[:3, 3].round(3) + 0.0).tolist()  # no -0.000
        return f"x {x:.3f}, y {y:.3f}, z {z:.3f} m: {way:.0f} mm and {turn:.0f} degrees away"
