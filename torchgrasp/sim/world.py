"""One PhysX scene: a Panda, the table and one target object."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import surface_points
from torchgrasp.sim import kinematics
from torchgrasp.sim._sapien import sapien
from torchgrasp.sim.panda import FINGER_CLOSED, Panda
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.table import build_table
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


class World:
    """A scene built anew for every episode, so that an episode depends on nothing before it.

    Building takes 2 to 3 ms, less than two control steps, and leaves no memory behind.
    """

    def __init__(self, placement: Placement) -> None:
        physics = placement.physics
        self.placement = placement
        self._system = sapien.physx.PhysxCpuSystem()
        self._scene = sapien.Scene([self._system])
        material = sapien.physx.PhysxMaterial(physics.friction, physics.friction, 0.0)
        build_table(self._scene, material)
        self._panda = Panda(
            self._scene, finger_friction=physics.finger_friction, finger_force=physics.finger_force
        )
        self._target = build_target(self._scene, placement.target, placement.T_base_object, physics, material)
        self._target.kinematic = placement.held
        self._radius = float(np.linalg.norm(surface_points(placement.target), axis=-1).max())
        self._carried: tuple[np.ndarray, np.ndarray] | None = None
        self._panda.place(placement.q)

    def copy(self) -> World:
        """Another world in which arm and target are where they are in this one, at rest, the fingers open."""
        placement = replace(self.placement, q=self.joints[:7], T_base_object=self.T_base_object)
        return World(placement)

    @property
    def joints(self) -> np.ndarray:
        """(9,) arm angles and finger positions."""
        return self._panda.articulation.qpos.astype(np.float64)

    @property
    def joint_velocities(self) -> np.ndarray:
        """(9,) rates of `joints`."""
        return self._panda.articulation.qvel.astype(np.float64)

    @property
    def T_base_object(self) -> np.ndarray:
        """(4, 4) pose of the target."""
        return self._target.entity_pose.to_transformation_matrix().astype(np.float64)

    def move_target(self, T_base_object: np.ndarray) -> None:
        """Put the target at a (4, 4) pose at once; one that is held is carried there in the next step."""
        if self._target.kinematic:
            self._carried = (self.T_base_object, T_base_object)
            return
        self._target.entity_pose = sapien.Pose(T_base_object)
        self._target.set_linear_velocity([0.0, 0.0, 0.0])
        self._target.set_angular_velocity([0.0, 0.0, 0.0])
        self._target.wake_up()

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
        self._panda.drive_arm_velocity(np.zeros(7))
        self._panda.drive_fingers(FINGER_CLOSED)
        slices = max(1, round(physics.close_seconds / 0.05))
        for i in range(slices):
            self._step(0.05, physics.close_rate)
            if i > 0 and np.abs(self.joint_velocities[7:]).max() < _STANDING:
                break
        if self._target.kinematic:
            self._target.kinematic = False
            self._target.wake_up()
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
        self._panda.drive_arm_velocity(np.zeros(7))
        self._step(0.1, physics.lift_rate)
        yield

    def _follow(self, start: np.ndarray, end: np.ndarray, seconds: float, rate: int) -> None:
        """Lead the drives from start to end at an even pace, their rate fed forward against the lag."""
        self._system.timestep = 1.0 / rate
        num_substeps = max(1, round(seconds * rate))
        step = (end - start) / num_substeps
        self._panda.drive_arm_velocity(step * rate)
        for i in range(1, num_substeps + 1):
            self._panda.drive_arm(start + i * step)
            if self._carried is not None:
                self._carry(i / num_substeps)
            self._system.step()

    def _carry(self, share: float) -> None:
        """Move the held target a share of its way, position alone: it arrives turned as it is told to be."""
        assert self._carried is not None
        before, after = self._carried
        pose = after.copy()
        pose[:3, 3] = (1.0 - share) * before[:3, 3] + share * after[:3, 3]
        self._target.set_kinematic_target(sapien.Pose(pose))

    def _step(self, seconds: float, rate: int) -> None:
        self._system.timestep = 1.0 / rate
        for _ in range(max(1, round(seconds * rate))):
            self._system.step()


def build_target(
    scene: sapien.Scene,
    target: GraspObject,
    T_base_object: np.ndarray,
    physics: Physics,
    material: sapien.physx.PhysxMaterial,
) -> sapien.physx.PhysxRigidDynamicComponent:
    """Add an object to a scene: convex parts, the mass that all objects share, damping."""
    body = sapien.physx.PhysxRigidDynamicComponent()
    for part in target.parts:
        shape = sapien.physx.PhysxCollisionShapeConvexMesh(vertices=part, scale=[1, 1, 1], material=material)
        shape.density = 1000.0
        shape.patch_radius = 0.1
        body.attach(shape)
    # PhysX's inertia at a density of 1000, brought to the wanted mass.
    scale = physics.mass / body.mass
    inertia = (np.asarray(body.inertia) * scale).tolist()
    body.mass = physics.mass
    body.inertia = inertia
    body.linear_damping = physics.linear_damping
    body.angular_damping = physics.angular_damping
    entity = sapien.Entity()
    entity.name = target.name
    entity.add_component(body)
    entity.pose = sapien.Pose(T_base_object)
    scene.add_entity(entity)
    return body
