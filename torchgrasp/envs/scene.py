"""The reset distribution rho_0 (Sec. 6.2): which object, where it is, how it moves, where the arm starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from torchgrasp.envs.motion import TargetMotion, moved
from torchgrasp.envs.starts import Start
from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects.gripper import MIN_CLEAR_GRASPS, hand_blocked
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.sets import ObjectSet
from torchgrasp.objects.surface import surface_points
from torchgrasp.sim import kinematics
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.reach import clear_grasps, in_reach
from torchgrasp.sim.settle import settled_poses

_MAX_TRIES = 1000
# Streams of randomness beside the scene's own, so that an option drawn from one leaves the others alone.
_PHYSICS, _APPEARANCE, _MOTION, _ORDER = 1, 2, 3, 4


@dataclass(frozen=True)
class Scene:
    """One draw.

    Attributes:
        object_id: index of the object.
        T_base_object: (4, 4) its pose.
        q: (7,) arm angles at the start.
        physics: of the episode.
        moves: (K, 3) moves of the target at the first K steps, see `torchgrasp.envs.motion`.
        appearance: seed of textures and light.
        held: whether the target is held in the air until the fingers have closed.
    """

    object_id: int
    T_base_object: np.ndarray
    q: np.ndarray
    physics: Physics
    moves: np.ndarray
    appearance: int
    held: bool = False

    def find_move(
        self, step: int, target: GraspObject, T_base_object: np.ndarray, T_base_ee: np.ndarray
    ) -> np.ndarray | None:
        """(4, 4) pose that the target moves to in a step, counted from 0; None where it stays.

        A target that nobody holds is not moved into the hand.
        """
        if step >= len(self.moves):
            return None
        after = moved(T_base_object, self.moves[step])
        if not self.held:
            hand = np.linalg.solve(after, T_base_ee)[None]
            if hand_blocked(surface_points(target), hand, approach=0.0, margin=0.01)[0]:
                return None
        return after


class SceneSampler:
    """Draws scenes: scene (seed, world, episode) is the same on every machine and in every batch.

    Objects are put down in poses that physics has proved to be stable, where at least eight of their
    grasps are clear of the table and have a posture of the arm. The way there is not proved: in a few
    scenes the expert finds it blocked.

    Args:
        objects: what is drawn from.
        physics: of the episodes; resting poses are proved in it too.
        start: the distribution of places and start postures.
        motion: how the target is presented and moves.
        object_order: ``random`` draws an object for each episode; ``cycle`` takes every object of the set in
            turn, in an order of each world's own, so that as many episodes as objects meet each once.
    """

    def __init__(
        self,
        objects: Sequence[GraspObject],
        *,
        physics: Physics,
        start: Start,
        motion: TargetMotion,
        object_order: Literal["random", "cycle"] = "random",
    ) -> None:
        if len(objects) == 0:
            raise ConfigError("objects is empty: choose another split or more objects.")
        if object_order not in ("random", "cycle"):
            raise ConfigError(f"object_order={object_order!r} is unknown: give random or cycle.")
        self.objects = objects
        self.physics, self.start, self.motion, self.object_order = physics, start, motion, object_order
        self._resting: dict[int, np.ndarray] = {}

    def sample(self, seed: int, world: int, episode: int) -> Scene:
        """The scene of one episode; raises ObjectError where no object can be presented.

        Objects that rest nowhere with eight grasps clear of the table are passed over.
        """
        rng, motion_rng = (
            np.random.default_rng((seed, world, episode)),
            self._stream(seed, world, episode, _MOTION),
        )
        for attempt in range(_MAX_TRIES):
            object_id = self._choose(rng, seed, world, episode, attempt)
            at_rest = self._put_down(rng, object_id)
            if at_rest is None:
                continue
            area = (self.start.table_x, self.start.table_y)
            presented = self.motion.present(motion_rng, at_rest, area)
            q = self._start_posture(rng, self.objects[object_id], presented.T_base_object)
            if q is not None:
                physics = self.physics.draw(self._stream(seed, world, episode, _PHYSICS))
                appearance = int(self._stream(seed, world, episode, _APPEARANCE).integers(2**31))
                return Scene(
                    object_id,
                    presented.T_base_object,
                    q,
                    physics,
                    presented.moves,
                    appearance,
                    presented.held,
                )
        raise ObjectError(
            f"None of {_MAX_TRIES} draws from {len(self.objects)} objects (the last: "
            f"{self.objects[object_id].name}) lies within reach with {MIN_CLEAR_GRASPS} grasps clear: "
            "choose other objects, or widen the table_x and table_y of the start."
        )

    @staticmethod
    def _stream(seed: int, world: int, episode: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng((seed, world, episode, purpose))

    def _choose(self, rng: np.random.Generator, seed: int, world: int, episode: int, attempt: int) -> int:
        """Index of the object that is tried."""
        if self.object_order == "cycle":
            # An object that cannot be presented is tried at twenty places before its turn is over.
            order = self._stream(seed, world, 0, _ORDER).permutation(len(self.objects))
            return int(order[(episode + attempt // 20) % len(order)])
        if isinstance(self.objects, ObjectSet):
            return self.objects.draw(rng)
        return int(rng.integers(len(self.objects)))

    def resting_poses(self, object_id: int) -> np.ndarray:
        """(K, 4, 4) proven resting poses in which at least eight grasps are clear of the table."""
        if object_id not in self._resting:
            target = self.objects[object_id]
            poses = settled_poses(target, self.physics)
            usable = [pose for pose in poses if len(clear_grasps(target, pose)) >= MIN_CLEAR_GRASPS]
            self._resting[object_id] = np.array(usable).reshape(-1, 4, 4)
        return self._resting[object_id]

    def _put_down(self, rng: np.random.Generator, object_id: int) -> np.ndarray | None:
        """(4, 4) pose at rest on the table, None where the object has none."""
        poses = self.resting_poses(object_id)
        if not len(poses):
            return None
        yaw, x, y = (
            rng.uniform(-np.pi, np.pi),
            rng.uniform(*self.start.table_x),
            rng.uniform(*self.start.table_y),
        )
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        turn[:2, 3] = x, y
        return turn @ poses[rng.integers(len(poses))]

    def _start_posture(
        self, rng: np.random.Generator, target: GraspObject, T_base_object: np.ndarray
    ) -> np.ndarray | None:
        """(7,) arm angles, None where too few grasps are in reach or the start finds no posture."""
        clear = clear_grasps(target, T_base_object)
        order = rng.permutation(len(clear))[:64]
        clear = type(clear)(clear.index[order], clear.T_base_ee[order])
        if len(in_reach(clear, kinematics.READY_POSTURE, at_most=MIN_CLEAR_GRASPS)) < MIN_CLEAR_GRASPS:
            return None
        return self.start.posture(rng, target, T_base_object)
