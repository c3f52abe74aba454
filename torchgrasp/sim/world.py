"""One PhysX scene: a Panda, the table and one target object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sapien
from sapien import Pose, physx

from torchgrasp.errors import check_range
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import kinematics
from torchgrasp.sim.panda import FINGER_CLOSED, Panda
from torchgrasp.sim.table import build_table


@dataclass(frozen=True)
class Physics:
    """What the world is made of. Every object has the same mass and friction (Sec. 6.2).

    Attributes:
        mass: of the target, kg.
        friction: static and dynamic, of target and table.
        finger_friction: of the finger pads.
        linear_damping, angular_damping: of the target, 1/s. PhysX knows no rolling friction; without
            an angular damping of this size round objects roll for ever.
        control_period: seconds a step of the policy lasts (released code: 0.15).
        approach_rate: physics steps a second while the hand moves.
        grasp_rate: physics steps a second while the fingers close and lift.
        close_seconds, lift_seconds: duration of the two.
        lift_height: metres that the hand rises at the end.
    """

    mass: float = 0.15
    friction: float = 1.0
    finger_friction: float = 2.0
    linear_damping: float = 0.1
    angular_damping: float = 10.0
    control_period: float = 0.15
    approach_rate: int = 120
    grasp_rate: int = 240
    close_seconds: float = 0.4
    lift_seconds: float = 1.2
    lift_height: float = 0.15

    def __post_init__(self) -> None:
        for name in (
            "mass",
            "control_period",
            "approach_rate",
            "grasp_rate",
            "close_seconds",
            "lift_seconds",
            "lift_height",
        ):
            check_range(f"physics.{name}", getattr(self, name), 0.0, np.inf, open_low=True)
        for name in ("friction", "finger_friction", "linear_damping", "angular_damping"):
            check_range(f"physics.{name}", getattr(self, name), 0.0, np.inf)


class World:
    """A scene built anew for every episode, so that an episode depends on nothing before it.

    Building takes 2 to 3 ms, less than two control steps, and leaves no memory behind.

    Args:
        physics: what the world is made of.
        target: the object to grasp.
        T_base_object: (4, 4) its pose.
        q: (7,) arm angles to start from.
    """

    def __init__(
        self, physics: Physics, target: GraspObject, T_base_object: np.ndarray, q: np.ndarray
    ) -> None:
        self.physics = physics
        self._system = physx.PhysxCpuSystem()
        self._scene = sapien.Scene([self._system])
        material = physx.PhysxMaterial(physics.friction, physics.friction, 0.0)
        build_table(self._scene, material)
        self._panda = Panda(self._scene, finger_friction=physics.finger_friction)
        self._target = build_target(self._scene, target, T_base_object, physics, material)
        self._panda.place(q)

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

    def drive(self, q: np.ndarray) -> None:
        """One control step with the arm's drives led to q (7,), no faster than the joints may turn."""
        seconds = self.physics.control_period
        reach = kinematics.JOINT_VELOCITY * seconds
        start = self.joints[:7]
        change = q - start
        change = change / max(1.0, float(np.max(np.abs(change) / reach)))
        self._follow(start, start + change, seconds, self.physics.approach_rate)

    def float_target(self, on: bool) -> None:
        """Take the target's weight away, or give it back."""
        self._target.disable_gravity = on

    def close_fingers(self) -> None:
        """Close the fingers on whatever is between them."""
        self._panda.drive_arm_velocity(np.zeros(7))
        self._panda.drive_fingers(FINGER_CLOSED)
        self._step(self.physics.close_seconds, self.physics.grasp_rate)

    def lift(self) -> None:
        """Raise the hand straight up by lift_height, as far as the arm reaches."""
        T_base_ee = kinematics.forward_kinematics(self.joints[None, :7])
        q, stages = self.joints[None, :7], 8
        seconds = self.physics.lift_seconds / stages
        for _ in range(stages):
            T_base_ee[:, 2, 3] += self.physics.lift_height / stages
            start = q[0]
            q, _ = kinematics.track_pose(q, T_base_ee)
            self._follow(start, q[0], seconds, self.physics.grasp_rate)
        self._panda.drive_arm_velocity(np.zeros(7))
        self._step(0.1, self.physics.grasp_rate)

    def _follow(self, start: np.ndarray, end: np.ndarray, seconds: float, rate: int) -> None:
        """Lead the drives from start to end at an even pace, their rate fed forward against the lag."""
        self._system.timestep = 1.0 / rate
        num_substeps = max(1, round(seconds * rate))
        step = (end - start) / num_substeps
        self._panda.drive_arm_velocity(step * rate)
        for i in range(1, num_substeps + 1):
            self._panda.drive_arm(start + i * step)
            self._system.step()

    def _step(self, seconds: float, rate: int) -> None:
        self._system.timestep = 1.0 / rate
        for _ in range(max(1, round(seconds * rate))):
            self._system.step()


def build_target(
    scene: sapien.Scene,
    target: GraspObject,
    T_base_object: np.ndarray,
    physics: Physics,
    material: physx.PhysxMaterial,
) -> physx.PhysxRigidDynamicComponent:
    """Add an object to a scene: convex parts, the mass that all objects share, damping."""
    body = physx.PhysxRigidDynamicComponent()
    for part in target.parts:
        shape = physx.PhysxCollisionShapeConvexMesh(vertices=part, scale=[1, 1, 1], material=material)
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
    entity.pose = Pose(T_base_object)
    scene.add_entity(entity)
    return body
