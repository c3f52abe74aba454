"""Where the arm starts, and the part of the table where objects are put down."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import torch

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.geometry import look_along
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import surface_points
from torchgrasp.sim import kinematics

_TRIES = 20
_MIN_HEIGHT = 0.03  # of the open hand above the table
# Looks down on the middle of the table, the hand 0.5 m above it.
TABLETOP_POSTURE = (0.0, -0.35, 0.0, -2.2, 0.0, 1.95, float(np.pi / 4))


@dataclass(frozen=True)
class Start(ABC):
    """Where an episode begins.

    Attributes:
        table_x, table_y: ranges in which the object is put down, metres, base frame.
    """

    table_x: tuple[float, float] = (0.40, 0.65)
    table_y: tuple[float, float] = (-0.25, 0.25)

    def __post_init__(self) -> None:
        for name in ("table_x", "table_y"):
            low, high = getattr(self, name)
            check_range(f"{name}[1]", high, low, np.inf)

    @abstractmethod
    def posture(
        self, rng: np.random.Generator, target: GraspObject, T_base_object: np.ndarray
    ) -> np.ndarray | None:
        """(7,) arm angles for an object at its (4, 4) pose; None where another scene must be drawn."""


@dataclass(frozen=True)
class StartPoses(Start):
    """The hand faces the target from a uniform distance, direction and roll (Sec. 6.2).

    Attributes:
        min_distance, max_distance: of the hand's origin from the object's centre of mass, metres.
        min_elevation: of the hand above the table as seen from the object, radians.
        aim: metres along each axis by which the point that the hand looks at may miss the centre of mass.
    """

    min_distance: float = 0.2
    max_distance: float = 0.5
    min_elevation: float = 0.35
    aim: float = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("min_distance", self.min_distance, 0.0, 1.0, open_low=True)
        check_range("max_distance", self.max_distance, self.min_distance, 1.0)
        check_range("min_elevation", self.min_elevation, 0.0, np.pi / 2)
        check_range("aim", self.aim, 0.0, 0.1)

    def posture(
        self, rng: np.random.Generator, target: GraspObject, T_base_object: np.ndarray
    ) -> np.ndarray | None:
        """See `Start.posture`."""
        for _ in range(_TRIES):
            T_base_ee = self._facing(rng, T_base_object[:3, 3])
            if lowest_point(T_base_ee) < _MIN_HEIGHT or touches(target, T_base_object, T_base_ee):
                continue
            postures = kinematics.sample_postures(T_base_ee, kinematics.READY_POSTURE)
            postures = postures[[posture_is_clear(q) for q in postures]] if len(postures) else postures
            if len(postures):
                return postures[0]
        return None

    def _facing(self, rng: np.random.Generator, centre: np.ndarray) -> np.ndarray:
        """(4, 4) hand pose that faces `centre`, uniform over directions, distances and rolls."""
        distance = rng.uniform(self.min_distance, self.max_distance)
        height = rng.uniform(np.sin(self.min_elevation), 1.0)
        azimuth, roll = rng.uniform(-np.pi, np.pi, size=2)
        level = np.sqrt(1.0 - height**2)
        offset = np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])
        T_base_ee = np.eye(4)
        T_base_ee[:3, 3] = centre + distance * offset
        aim = centre + rng.uniform(-1, 1, 3) * self.aim - T_base_ee[:3, 3]
        T_base_ee[:3, :3] = look_along(torch.from_numpy(aim), torch.tensor(roll, dtype=torch.float64)).numpy()
        return T_base_ee


@dataclass(frozen=True)
class TabletopStart(Start):
    """One posture that looks down on the table, or postures around it (tabletop protocol, Sec. 6.7).

    Attributes:
        q: (7,) arm angles, radians.
        spread: largest deviation of each angle, radians; 0 is the protocol's fixed start.
        view: half angle of the cone about the hand's z in which the target must lie, radians.
    """

    q: tuple[float, ...] = TABLETOP_POSTURE
    spread: float = 0.0
    view: float = 0.7

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.q) != 7:
            raise ConfigError(f"q={list(self.q)}: give the seven angles of the arm, radians.")
        check_range("spread", self.spread, 0.0, np.pi)
        check_range("view", self.view, 0.0, np.pi, open_low=True)

    def posture(
        self, rng: np.random.Generator, target: GraspObject, T_base_object: np.ndarray
    ) -> np.ndarray | None:
        """See `Start.posture`."""
        for _ in range(_TRIES if self.spread else 1):
            q = np.asarray(self.q) + self.spread * rng.uniform(-1, 1, 7)
            T_base_ee = kinematics.forward_kinematics(q[None])[0]
            seen = T_base_ee[:3, :3].T @ (T_base_object[:3, 3] - T_base_ee[:3, 3])
            in_view = np.arctan2(np.hypot(seen[0], seen[1]), seen[2]) < self.view
            high = lowest_point(T_base_ee) > _MIN_HEIGHT
            if in_view and high and posture_is_clear(q) and not touches(target, T_base_object, T_base_ee):
                return q
        return None


def touches(target: GraspObject, T_base_object: np.ndarray, T_base_ee: np.ndarray) -> bool:
    """Whether a sample of the object's surface lies in a box around open hand and flange.

    The box leaves 2 to 3 cm around the hand and reaches 13.5 cm behind its origin, along the wrist.
    """
    T_object_ee = np.linalg.solve(T_base_object, T_base_ee)
    seen = (surface_points(target) - T_object_ee[:3, 3]) @ T_object_ee[:3, :3]
    near = np.abs(seen) < (0.05, 0.13, 0.135)
    return bool(np.any(np.all(near, axis=-1)))


def posture_is_clear(q: np.ndarray) -> bool:
    """Whether elbow, forearm and wrist stay 8 cm above the table and off the joint limits."""
    margin = np.minimum(q - kinematics.JOINT_LOWER, kinematics.JOINT_UPPER - q).min()
    heights = kinematics.link_poses(q[None])[0, 3:7, 2, 3]
    return bool(margin > 0.05 and heights.min() > 0.08)
