"""One PhysX scene: a Panda, the table and one target object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim._sapien import load_sapien, sapien
from torchgrasp.sim.engine import Engine
from torchgrasp.sim.panda import Panda
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.table import build_table
from torchgrasp.sim.world import Placement, World


@dataclass(frozen=True)
class SapienEngine(Engine):
    """SAPIEN's PhysX on the CPU: the physics that objects rest and grasps are proved in."""

    name: ClassVar[str] = "sapien"

    def build(self, placement: Placement) -> World:
        """A scene in PhysX: 2 to 3 ms."""
        return SapienWorld(placement)

    def check(self) -> None:
        """Import sapien."""
        load_sapien()


class SapienWorld(World):
    """A `World` in PhysX.

    Building takes 2 to 3 ms, less than two control steps, and leaves no memory behind.
    """

    def __init__(self, placement: Placement) -> None:
        super().__init__(placement)
        physics = placement.physics
        self._system = sapien.physx.PhysxCpuSystem()
        self._scene = sapien.Scene([self._system])
        material = sapien.physx.PhysxMaterial(physics.friction, physics.friction, 0.0)
        build_table(self._scene, material)
        self._panda = Panda(
            self._scene, finger_friction=physics.finger_friction, finger_force=physics.finger_force
        )
        self._target = build_target(self._scene, placement.target, placement.T_base_object, physics, material)
        self._target.kinematic = placement.held
        self._panda.place(placement.q)

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

    @property
    def held(self) -> bool:
        """Whether the target is kinematic."""
        return self._target.kinematic

    def _lead_arm(self, q: np.ndarray) -> None:
        self._panda.drive_arm(q)

    def _lead_arm_velocity(self, rate: np.ndarray) -> None:
        self._panda.drive_arm_velocity(rate)

    def _lead_fingers(self, opening: float) -> None:
        self._panda.drive_fingers(opening)

    def _put_target(self, T_base_object: np.ndarray) -> None:
        self._target.entity_pose = sapien.Pose(T_base_object)
        self._target.set_linear_velocity([0.0, 0.0, 0.0])
        self._target.set_angular_velocity([0.0, 0.0, 0.0])
        self._target.wake_up()

    def _carry_target(self, T_base_object: np.ndarray) -> None:
        self._target.set_kinematic_target(sapien.Pose(T_base_object))

    def _let_go(self) -> None:
        self._target.kinematic = False
        self._target.wake_up()

    def _advance(self, rate: int) -> None:
        self._system.timestep = 1.0 / rate
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
