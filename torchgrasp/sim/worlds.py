"""N worlds as one object with batched reads and writes.

The seam behind which another physics backend can stand: nothing outside sim/ sees a single world.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchgrasp.objects.gripper import lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import kinematics
from torchgrasp.sim.camera import Camera, View
from torchgrasp.sim.world import Physics, World

# Metres above the table at which the controller holds the hand's lowest corner.
TABLE_GUARD = 0.002


class Worlds:
    """A batch of independent worlds in one process.

    Args:
        num_worlds: N.
        physics: what they are made of.
        camera: the wrist camera, shared.
    """

    def __init__(self, num_worlds: int, *, physics: Physics, camera: Camera) -> None:
        self.physics = physics
        self.camera = camera
        self._worlds: list[World | None] = [None] * num_worlds
        self._targets: list[GraspObject | None] = [None] * num_worlds

    def __len__(self) -> int:
        return len(self._worlds)

    def place(self, row: int, target: GraspObject, T_base_object: np.ndarray, q: np.ndarray) -> None:
        """Begin an episode in world `row`: the object at its (4, 4) pose, the arm at rest at q (7,)."""
        self._worlds[row] = World(self.physics, target, T_base_object, q)
        self._targets[row] = target

    def _placed(self) -> list[World]:
        worlds = [world for world in self._worlds if world is not None]
        if len(worlds) < len(self._worlds):
            raise RuntimeError("Every world needs place() before it is read or driven.")
        return worlds

    @property
    def joints(self) -> np.ndarray:
        """(N, 9) arm angles and finger positions."""
        return np.stack([world.joints for world in self._placed()])

    @property
    def joint_velocities(self) -> np.ndarray:
        """(N, 9) rates of `joints`."""
        return np.stack([world.joint_velocities for world in self._placed()])

    @property
    def T_base_ee(self) -> np.ndarray:
        """(N, 4, 4) hand poses."""
        return kinematics.forward_kinematics(self.joints[:, :7])

    @property
    def T_base_object(self) -> np.ndarray:
        """(N, 4, 4) poses of the targets."""
        return np.stack([world.T_base_object for world in self._placed()])

    def observe(self) -> dict[str, np.ndarray]:
        """(N, H, W, ...) pictures of the wrist cameras by channel, see `Camera.observe`."""
        joints, T_base_ee, T_base_object = self.joints, self.T_base_ee, self.T_base_object
        pictures = [
            self.camera.observe(View(target, T_base_object[i], joints[i], T_base_ee[i]))
            for i, target in enumerate(self._targets)
            if target is not None
        ]
        return {channel: np.stack([each[channel] for each in pictures]) for channel in self.camera.channels}

    def drive_to_pose(self, T_base_ee: np.ndarray, rows: Sequence[int]) -> None:
        """One control step of the worlds `rows` towards hand poses (N, 4, 4), all N given.

        A pose out of reach is approached as far as the joint limits let the arm go. One that would put
        the hand into the table is raised: the controller knows its table, as a real one's workspace
        limits do, and a policy sees nothing of it.
        """
        worlds, index = self._placed(), list(rows)
        T_base_ee = T_base_ee[index]
        T_base_ee[:, 2, 3] += np.maximum(0.0, TABLE_GUARD - lowest_point(T_base_ee))
        q, _ = kinematics.track_pose(self.joints[index, :7], T_base_ee)
        for row, target in zip(index, q, strict=True):
            worlds[row].drive(target)

    def close_and_lift(self, rows: Sequence[int]) -> np.ndarray:
        """Close the fingers and lift in the worlds `rows`; (len(rows),) metres that each target rose."""
        worlds = self._placed()
        rise = np.zeros(len(rows))
        for i, row in enumerate(rows):
            before = worlds[row].T_base_object[2, 3]
            worlds[row].close_fingers()
            worlds[row].lift()
            rise[i] = worlds[row].T_base_object[2, 3] - before
        return rise
