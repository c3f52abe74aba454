"""What a world is, whatever engine moves it: how an arm is led, fingers close, and a target is lifted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from torchgrasp.errors import UnstableError
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import surface_points
from torchgrasp.sim import kinematics
from torchgrasp.sim.panda_tables import FINGER_CLOSED
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.tracking import track_pose

# The open hand's box in its frame, for the question how near the target is.
_HAND_CENTRE, _HAND_HALF = np.array([0.0, 0.0, 0.0435]), np.array([0.0315, 0.102, 0.0695])
_HAND_RADIUS = float(np.linalg.norm(_HAND_HALF))
_STANDING = 2e-3  # m/s below which a finger stands
_LIFT_STAGES = 8
# Metres that an object must have risen to count as lifted (released code).
LIFTED = 0.08


@dataclass(frozen=True)
class Placement:
    """How an episode begins in one world.

    Attributes:
        target: the object to grasp.
        T_base_object: (4, 4) its pose.
        q: (7,) arm angles to start from.
        physics: of the episode.
        held: whether the target is held where it is put, as by a person's hand, until it is grasped.
        appearance: seed of textures and light.
    """

    target: GraspObject
    T_base_object: np.ndarray
    q: np.ndarray
    physics: Physics
    held: bool = False
    appearance: int = 0


class World(ABC):
    """A scene built anew for every episode, so that an episode depends on nothing before it.

    An engine's own world says how its bodies are read, driven and stepped; what is done with them is here,
    once for all engines. At the end of `__init__` the arm stands at the placement's q, fingers open, at rest.
    Where a motion makes the physics unstable, UnstableError is raised; the world is then of no use.

    Args:
        placement: how the episode begins.
    """

    def __init__(self, placement: Placement) -> None:
        self.placement = placement
        self._radius = float(np.linalg.norm(surface_points(placement.target), axis=-1).max())
        self._carried: tuple[np.ndarray, np.ndarray] | None = None

    @property
    @abstractmethod
    def joints(self) -> np.ndarray:
        """(9,) arm angles and finger positions."""

    @property
    @abstractmethod
    def joint_velocities(self) -> np.ndarray:
        """(9,) rates of `joints`."""

    @property
    @abstractmethod
    def T_base_object(self) -> np.ndarray:
        """(4, 4) pose of the target."""

    @property
    @abstractmethod
    def held(self) -> bool:
        """Whether the target is held where it is put, so that no contact moves it."""

    @abstractmethod
    def _lead_arm(self, q: np.ndarray) -> None:
        """Set the targets of the arm's drives, (7,) radians."""

    @abstractmethod
    def _lead_arm_velocity(self, rate: np.ndarray) -> None:
        """Set the rates at which those targets move, (7,) rad/s."""

    @abstractmethod
    def _lead_fingers(self, opening: float) -> None:
        """Set the targets of both fingers' drives, metres each."""

    @abstractmethod
    def _put_target(self, T_base_object: np.ndarray) -> None:
        """Put a target that is not held at a (4, 4) pose, at rest."""

    @abstractmethod
    def _carry_target(self, T_base_object: np.ndarray) -> None:
        """Let a held target be at a (4, 4) pose after the next physics step."""

    @abstractmethod
    def _let_go(self) -> None:
        """From now on the held target moves freely; it is at rest."""

    @abstractmethod
    def _advance(self, rate: int) -> None:
        """One physics step of 1 / rate seconds.

        An engine that begins anew where a number is out of its range raises UnstableError here.
        """

    def place_again(self) -> Placement:
        """How another world begins where arm and target of this one are, at rest, the fingers open."""
        return replace(self.placement, q=self.joints[:7], T_base_object=self.T_base_object)

    def move_target(self, T_base_object: np.ndarray) -> None:
        """Put the target at a (4, 4) pose at once; one that is held is carried there in the next step."""
        if self.held:
            self._carried = (self.T_base_object, T_base_object)
        else:
            self._put_target(T_base_object)

    def drive(self, q: np.ndarray) -> None:
        """One control step with the arm's drives led to q (7,), no faster than the joints may turn."""
        physics = self.placement.physics
        reach = kinematics.JOINT_VELOCITY * physics.control_period
        start = self.joints[:7]
        change = q - start
        change = change / max(1.0, float(np.max(np.abs(change) / reach)))
        rate = physics.approach_rate if self._is_near(start, start + change) else physics.free_rate
        self._follow(start, start + change, physics.control_period, rate)
        self._carried = None

    def _is_near(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Whether hand and target may come within `near` of each other on the way."""
        T_base_object = self.T_base_object if self._carried is None else self._carried[1]
        points = surface_points(self.placement.target)
        hands = kinematics.forward_kinematics(np.stack((start, end)))
        near = self.placement.physics.near
        apart = hands[:, :3, 3] + _HAND_CENTRE[2] * hands[:, :3, 2] - T_base_object[:3, 3]
        if np.linalg.norm(apart, axis=-1).min() > self._radius + _HAND_RADIUS + near:
            return False
        points = points @ T_base_object[:3, :3].T + T_base_object[:3, 3]
        for hand in hands:
            outside = np.abs((points - hand[:3, 3]) @ hand[:3, :3] - _HAND_CENTRE) - _HAND_HALF
            nearest = np.maximum(outside, 0.0)
            if np.einsum("ij,ij->i", nearest, nearest).min() < near**2:
                return True
        return False

    def close_fingers(self) -> None:
        """Close the fingers on whatever is between them, until they stand; a held target is then let go."""
        physics = self.placement.physics
        self._lead_arm_velocity(np.zeros(7))
        self._lead_fingers(FINGER_CLOSED)
        slices = max(1, round(physics.close_seconds / 0.05))
        for i in range(slices):
            self._step(0.05, physics.close_rate)
            if i > 0 and np.abs(self.joint_velocities[7:]).max() < _STANDING:
                break
        if self.held:
            self._let_go()
        self._step(0.05, physics.close_rate)

    def lift(self) -> Iterator[None]:
        """Raise the hand straight up by lift_height, as far as the arm reaches, stage by stage."""
        physics = self.placement.physics
        T_base_ee = kinematics.forward_kinematics(self.joints[None, :7])
        q, seconds = self.joints[None, :7], physics.lift_seconds / _LIFT_STAGES
        for _ in range(_LIFT_STAGES):
            T_base_ee[:, 2, 3] += physics.lift_height / _LIFT_STAGES
            start = q[0]
            q, _ = track_pose(q, T_base_ee)
            self._follow(start, q[0], seconds, physics.lift_rate)
            yield
        self._lead_arm_velocity(np.zeros(7))
        self._step(0.1, physics.lift_rate)
        yield

    def _follow(self, start: np.ndarray, end: np.ndarray, seconds: float, rate: int) -> None:
        """Lead the drives from start to end at an even pace, their rate fed forward against the lag."""
        num_substeps = max(1, round(seconds * rate))
        step = (end - start) / num_substeps
        self._lead_arm_velocity(step * rate)
        for i in range(1, num_substeps + 1):
            self._lead_arm(start + i * step)
            if self._carried is not None:
                self._carry(i / num_substeps)
            self._advance(rate)
        self._check_stable()

    def _carry(self, share: float) -> None:
        """Move the held target a share of its way, position alone: it arrives turned as it is told to be."""
        assert self._carried is not None
        before, after = self._carried
        pose = after.copy()
        pose[:3, 3] = (1.0 - share) * before[:3, 3] + share * after[:3, 3]
        self._carry_target(pose)

    def _step(self, seconds: float, rate: int) -> None:
        for _ in range(max(1, round(seconds * rate))):
            self._advance(rate)
        self._check_stable()

    def _check_stable(self) -> None:
        if not (np.isfinite(self.joints).all() and np.isfinite(self.T_base_object).all()):
            raise UnstableError(
                f"The physics became unstable with {self.placement.target.name}: raise the physics' rates, "
                "or look at its masses and forces."
            )
