"""The reset distribution rho_0 (Sec. 6.2): which object, where it lies, where the arm starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchgrasp.errors import ConfigError, ObjectError, check_range
from torchgrasp.geometry import look_along
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import surface_points
from torchgrasp.sim import kinematics
from torchgrasp.sim.reach import clear_grasps, in_reach
from torchgrasp.sim.settle import settle
from torchgrasp.sim.world import Physics

_MAX_TRIES = 1000
_MIN_GRASPS = 8


@dataclass(frozen=True)
class Scene:
    """One draw: the object's index and (4, 4) pose, and the arm's (7,) start angles."""

    object_id: int
    T_base_object: np.ndarray
    q: np.ndarray


@dataclass(frozen=True)
class StartPoses:
    """Where episodes begin (Sec. 6.2): the hand faces the target from a uniform distance.

    Attributes:
        min_distance, max_distance: of the hand's origin from the object's centre of mass, metres.
        min_elevation: of the hand above the table as seen from the object, radians.
        aim: metres along each axis by which the point that the hand looks at may miss the centre of mass.
        table_x, table_y: ranges in which the object is put down, metres, base frame.
    """

    min_distance: float = 0.2
    max_distance: float = 0.5
    min_elevation: float = 0.35
    aim: float = 0.02
    table_x: tuple[float, float] = (0.40, 0.65)
    table_y: tuple[float, float] = (-0.25, 0.25)

    def __post_init__(self) -> None:
        check_range("start.min_distance", self.min_distance, 0.0, 1.0, open_low=True)
        check_range("start.max_distance", self.max_distance, self.min_distance, 1.0)
        check_range("start.min_elevation", self.min_elevation, 0.0, np.pi / 2)
        check_range("start.aim", self.aim, 0.0, 0.1)


class SceneSampler:
    """Draws scenes: scene (seed, world, episode) is the same on every machine and in every batch.

    Objects are put down in poses that physics has proved to be stable, where at least eight of their
    grasps are clear of the table and have a posture of the arm. The way there is not proved: in a few
    scenes the expert finds it blocked.

    Args:
        objects: what is drawn from, uniformly.
        physics: in which resting poses are proved.
        start: the distribution of places and start poses.
    """

    def __init__(self, objects: Sequence[GraspObject], *, physics: Physics, start: StartPoses) -> None:
        if len(objects) == 0:
            raise ConfigError("The object set is empty: choose another split or more objects.")
        self.objects = objects
        self.start = start
        self._physics = physics
        self._resting: dict[int, np.ndarray] = {}

    def sample(self, seed: int, world: int, episode: int) -> Scene:
        """The scene of one episode; raises ObjectError where no object can be presented.

        Objects that rest nowhere with eight grasps clear of the table are passed over.
        """
        rng = np.random.default_rng((seed, world, episode))
        for _ in range(_MAX_TRIES):
            object_id = int(rng.integers(len(self.objects)))
            T_base_object = self._put_down(rng, object_id)
            if T_base_object is None:
                continue
            if (q := self._start_posture(rng, self.objects[object_id], T_base_object)) is not None:
                return Scene(object_id, T_base_object, q)
        raise ObjectError(
            f"None of {_MAX_TRIES} draws from {len(self.objects)} objects (the last: "
            f"{self.objects[object_id].name}) lies within reach with {_MIN_GRASPS} grasps clear: "
            "choose other objects, or widen start.table_x and start.table_y."
        )

    def resting_poses(self, object_id: int) -> np.ndarray:
        """(K, 4, 4) proven resting poses in which at least eight grasps are clear of the table."""
        if object_id not in self._resting:
            target = self.objects[object_id]
            poses = settle(target, self._physics)
            usable = [pose for pose in poses if len(clear_grasps(target, pose)) >= _MIN_GRASPS]
            self._resting[object_id] = np.array(usable).reshape(-1, 4, 4)
        return self._resting[object_id]

    def _put_down(self, rng: np.random.Generator, object_id: int) -> np.ndarray | None:
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
        clear = clear_grasps(target, T_base_object)
        order = rng.permutation(len(clear))[:64]
        clear = type(clear)(clear.index[order], clear.T_base_ee[order])
        if len(in_reach(clear, kinematics.READY_POSTURE, at_most=_MIN_GRASPS)) < _MIN_GRASPS:
            return None
        for _ in range(20):
            T_base_ee = self._facing(rng, T_base_object[:3, 3])
            if lowest_point(T_base_ee) < 0.03 or _touches(target, T_base_object, T_base_ee):
                continue
            postures = kinematics.sample_postures(T_base_ee, kinematics.READY_POSTURE)
            postures = postures[[_posture_is_clear(q) for q in postures]] if len(postures) else postures
            if len(postures):
                return postures[0]
        return None

    def _facing(self, rng: np.random.Generator, centre: np.ndarray) -> np.ndarray:
        """(4, 4) hand pose that faces `centre`, uniform over directions, distances and rolls."""
        start = self.start
        distance = rng.uniform(start.min_distance, start.max_distance)
        height = rng.uniform(np.sin(start.min_elevation), 1.0)
        azimuth, roll = rng.uniform(-np.pi, np.pi, size=2)
        level = np.sqrt(1.0 - height**2)
        offset = np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])
        T_base_ee = np.eye(4)
        T_base_ee[:3, 3] = centre + distance * offset
        aim = centre + rng.uniform(-1, 1, 3) * start.aim - T_base_ee[:3, 3]
        T_base_ee[:3, :3] = look_along(torch.from_numpy(aim), torch.tensor(roll, dtype=torch.float64)).numpy()
        return T_base_ee


def _touches(target: GraspObject, T_base_object: np.ndarray, T_base_ee: np.ndarray) -> bool:
    """Whether a sample of the object's surface lies in a box around open hand and flange.

    The box leaves 2 to 3 cm around the hand and reaches 13.5 cm behind its origin, along the wrist.
    """
    T_object_ee = np.linalg.solve(T_base_object, T_base_ee)
    seen = (surface_points(target) - T_object_ee[:3, 3]) @ T_object_ee[:3, :3]
    near = np.abs(seen) < (0.05, 0.13, 0.135)
    return bool(np.any(np.all(near, axis=-1)))


def _posture_is_clear(q: np.ndarray) -> bool:
    """Whether elbow, forearm and wrist stay 8 cm above the table and off the joint limits."""
    margin = np.minimum(q - kinematics.JOINT_LOWER, kinematics.JOINT_UPPER - q).min()
    heights = kinematics.link_poses(q[None])[0, 3:7, 2, 3]
    return bool(margin > 0.05 and heights.min() > 0.08)
