"""N worlds as one object with batched reads and writes.

The seam behind which the engines stand: nothing outside sim/ sees a single world.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np

from torchgrasp.errors import UnstableError
from torchgrasp.sim import kinematics
from torchgrasp.sim.camera import Camera, View
from torchgrasp.sim.engine import Engine
from torchgrasp.sim.engines import EngineName, make_engine
from torchgrasp.sim.world import Placement, World


class Worlds:
    """A batch of independent worlds in one process; reads are copies of what the last write left.

    A world whose physics becomes unstable ends for itself alone: what is read of it stays as it was before,
    and nothing moves it until an episode begins in it again.

    Args:
        num_worlds: N.
        engine: whose physics moves them: ``sapien``, ``mujoco``, or an engine itself.

    Attributes:
        engine: the same, as an `Engine`.
        watcher: called with a world's row after its fingers closed and at each stage of its lift, between
            which nothing is observed; how films show them.
    """

    def __init__(self, num_worlds: int, *, engine: Engine | EngineName = "sapien") -> None:
        self.engine = make_engine(engine)
        self._worlds: list[World | None] = [None] * num_worlds
        self._unstable = np.zeros(num_worlds, dtype=bool)
        self.watcher: Callable[[int], None] | None = None
        self._joints, self._joint_velocities = np.zeros((2, num_worlds, 9))
        self._T_base_ee, self._T_base_object = np.tile(np.eye(4), (2, num_worlds, 1, 1))

    def __len__(self) -> int:
        return len(self._worlds)

    def place(self, row: int, placement: Placement) -> None:
        """Begin an episode in world `row`, the arm at rest."""
        self._worlds[row], self._unstable[row] = self.engine.build(placement), False
        self._read([row])

    def _placed(self) -> list[World]:
        worlds = [world for world in self._worlds if world is not None]
        if len(worlds) < len(self._worlds):
            raise RuntimeError("Every world needs place() before it is read or driven.")
        return worlds

    def _read(self, rows: Sequence[int]) -> None:
        """Take over the state of the worlds `rows`."""
        for row in rows:
            world = self._worlds[row]
            assert world is not None
            if self._unstable[row]:
                continue
            self._joints[row], self._joint_velocities[row] = world.joints, world.joint_velocities
            self._T_base_object[row] = world.T_base_object
        index = list(rows)
        self._T_base_ee[index] = kinematics.forward_kinematics(self._joints[index, :7])

    @property
    def joints(self) -> np.ndarray:
        """(N, 9) arm angles and finger positions."""
        return self._joints.copy()

    @property
    def joint_velocities(self) -> np.ndarray:
        """(N, 9) rates of `joints`."""
        return self._joint_velocities.copy()

    @property
    def T_base_ee(self) -> np.ndarray:
        """(N, 4, 4) hand poses."""
        return self._T_base_ee.copy()

    @property
    def T_base_object(self) -> np.ndarray:
        """(N, 4, 4) poses of the targets."""
        return self._T_base_object.copy()

    @property
    def unstable(self) -> np.ndarray:
        """(N,) bool: worlds whose physics became unstable in their episode."""
        return self._unstable.copy()

    def observe(self, camera: Camera) -> dict[str, np.ndarray]:
        """(N, H, W, ...) pictures of one camera in every world by channel, see `Camera.observe`."""
        pictures = []
        for i, world in enumerate(self._placed()):
            given = world.placement
            state = (self._T_base_object[i], self._joints[i], self._T_base_ee[i])
            pictures.append(camera.observe(View(given.target, *state, given.appearance)))
        return {channel: np.stack([each[channel] for each in pictures]) for channel in camera.channels}

    def drive(self, q: np.ndarray, rows: Sequence[int]) -> None:
        """One control step of the worlds `rows` towards postures (len(rows), 7)."""
        worlds = self._placed()
        for row, target in zip(rows, q, strict=True):
            if not self._unstable[row]:
                with self._noting(row):
                    worlds[row].drive(target)
        self._read(rows)

    @contextmanager
    def _noting(self, row: int) -> Iterator[None]:
        """Note where world `row` becomes unstable."""
        try:
            yield
        except UnstableError:
            self._unstable[row] = True

    def move_target(self, row: int, T_base_object: np.ndarray) -> None:
        """Put the target of world `row` at a (4, 4) pose; a held one gets there in the next `drive`."""
        self._placed()[row].move_target(T_base_object)
        self._read([row])

    def _show(self, row: int) -> None:
        if self.watcher is not None:
            self._read([row])
            self.watcher(row)

    def try_last(
        self, row: int, postures: np.ndarray, *, T_base_object: np.ndarray | None = None
    ) -> np.ndarray:
        """How far the target of world `row` would rise after one more step; the world stays as it is.

        Each of M postures is the last step of a copy of the world, which begins at rest. Then the fingers
        close and the hand lifts.

        Args:
            row: of the world.
            postures: (M, 7) joint angles that the arm is led to.
            T_base_object: (4, 4) pose that the target moves to before the step, None where it stays.

        Returns:
            (M,) metres; NaN where the physics became unstable.
        """
        return np.array([self._try(row, q, T_base_object) for q in postures])

    def _try(self, row: int, q: np.ndarray, T_base_object: np.ndarray | None) -> float:
        world = self.engine.build(self._placed()[row].place_again())
        if T_base_object is not None:
            world.move_target(T_base_object)
        with suppress(UnstableError):
            world.drive(q)
            return _close_and_lift(world)
        return math.nan

    def close_and_lift(self, rows: Sequence[int]) -> np.ndarray:
        """Close the fingers and lift in the worlds `rows`.

        Returns:
            (len(rows),) metres that each target rose; NaN where the physics became unstable.
        """
        worlds, risen = self._placed(), np.full(len(rows), np.nan)
        for i, row in enumerate(rows):
            if not self._unstable[row]:
                with self._noting(row):
                    risen[i] = _close_and_lift(worlds[row], functools.partial(self._show, row))
        self._read(rows)
        return risen


def _close_and_lift(world: World, show: Callable[[], object] = lambda: None) -> float:
    """Metres that the target rises; `show` follows the closing of the fingers and each stage of the lift."""
    before = world.T_base_object[2, 3]
    world.close_fingers()
    show()
    for _ in world.lift():
        show()
    return float(world.T_base_object[2, 3] - before)
