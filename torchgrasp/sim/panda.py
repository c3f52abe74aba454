"""The Franka Emika Panda as a SAPIEN articulation."""

from __future__ import annotations

import numpy as np

from torchgrasp.sim import kinematics
from torchgrasp.sim._sapien import sapien
from torchgrasp.sim.panda_tables import (
    ARM_DAMPING,
    ARM_SHAPES,
    ARM_STIFFNESS,
    BODY_FRICTION,
    FINGER_ARMATURE,
    FINGER_DAMPING,
    FINGER_INERTIAL,
    FINGER_MOUNT,
    FINGER_OPEN,
    FINGER_SHAPES,
    FINGER_STIFFNESS,
    FINGER_VELOCITY,
    HAND_INERTIAL,
    HAND_SHAPES,
    IGNORE_BITS,
    INERTIALS,
    Inertial,
    Shape,
    mirrored,
)

_ROBOT_ID = 1


class Panda:
    """One Panda standing at the origin of a scene: its articulation, drives and links.

    Args:
        scene: the SAPIEN scene to build into.
        finger_friction: static and dynamic friction of the fingers.
        finger_force: largest force of each finger, N.
    """

    def __init__(
        self, scene: sapien.Scene, *, finger_friction: float = 2.0, finger_force: float = 40.0
    ) -> None:
        self._body_material = sapien.physx.PhysxMaterial(BODY_FRICTION, BODY_FRICTION, 0.0)
        self._finger_material = sapien.physx.PhysxMaterial(finger_friction, finger_friction, 0.0)
        builder = scene.create_articulation_builder()
        self._build_links(builder)
        self.articulation = builder.build(fix_root_link=True)
        self.articulation.name = "panda"
        for link in self.articulation.links:
            link.disable_gravity = True
        self._arm_joints = self.articulation.active_joints[:7]
        self._finger_joints = self.articulation.active_joints[7:]
        for joint, effort, speed in zip(
            self._arm_joints, kinematics.JOINT_EFFORT, kinematics.JOINT_VELOCITY, strict=True
        ):
            joint.set_drive_properties(ARM_STIFFNESS, ARM_DAMPING, float(effort))
            joint.set_max_velocity(float(speed))
        for joint in self._finger_joints:
            joint.set_drive_properties(FINGER_STIFFNESS, FINGER_DAMPING, finger_force)
            joint.set_max_velocity(FINGER_VELOCITY)
            joint.set_armature([FINGER_ARMATURE])
        self.links = self.articulation.links

    def _build_links(self, builder: sapien.ArticulationBuilder) -> None:
        link = builder.create_link_builder()
        self._fill(link, "link0", INERTIALS[0], ARM_SHAPES[0])
        limits = zip(kinematics.JOINT_LOWER, kinematics.JOINT_UPPER, strict=True)
        for i, (origin, limit) in enumerate(zip(kinematics.JOINT_ORIGINS, limits, strict=True), start=1):
            link = builder.create_link_builder(link)
            self._fill(link, f"link{i}", INERTIALS[i], ARM_SHAPES[i])
            link.set_joint_properties(
                "revolute", limit, _axis_frame(origin, "z"), _axis_frame(((0, 0, 0), 0.0), "z")
            )
        hand = builder.create_link_builder(link)
        self._fill(hand, "hand", HAND_INERTIAL, HAND_SHAPES)
        hand.set_joint_properties("fixed", (0, 0), sapien.Pose(kinematics.hand_in_link7()), sapien.Pose())
        for side, name in ((1.0, "left_finger"), (-1.0, "right_finger")):
            finger = builder.create_link_builder(hand)
            shapes = FINGER_SHAPES if side > 0 else tuple(mirrored(s) for s in FINGER_SHAPES)
            self._fill(finger, name, FINGER_INERTIAL, shapes)
            frame = "y" if side > 0 else "-y"
            finger.set_joint_properties(
                "prismatic",
                (0.0, FINGER_OPEN),
                _axis_frame(((0, 0, FINGER_MOUNT), 0.0), frame),
                _axis_frame(((0, 0, 0), 0.0), frame),
            )

    def _fill(self, link, name: str, inertial: Inertial, shapes: tuple[Shape, ...]) -> None:
        link.set_name(name)
        link.set_joint_name(f"{name}_joint")
        is_finger = name.endswith("finger")
        link.collision_groups = [1, 1, IGNORE_BITS["finger" if is_finger else name], _ROBOT_ID]
        moments, axes = _principal_axes(inertial)
        link.set_mass_and_inertia(inertial.mass, sapien.Pose(axes), moments)
        material = self._finger_material if is_finger else self._body_material
        for shape in shapes:
            _add_shape(link, shape, material, patch_radius=0.1 if is_finger else 0.0)

    def place(self, q: np.ndarray, *, fingers: float = FINGER_OPEN) -> None:
        """Put the arm at rest at q (7,) with the fingers `fingers` metres open each, drives on target."""
        self.articulation.set_qpos(np.concatenate((q, (fingers, fingers))).astype(np.float32))
        self.articulation.set_qvel(np.zeros(9, dtype=np.float32))
        self.drive_arm(q)
        self.drive_fingers(fingers)

    def drive_arm(self, q: np.ndarray) -> None:
        """Set the arm's drive targets, (7,) radians."""
        for joint, target in zip(self._arm_joints, q.tolist(), strict=True):
            joint.set_drive_target(target)

    def drive_arm_velocity(self, rate: np.ndarray) -> None:
        """Set the rates at which the drive targets move, (7,) rad/s: damping then holds nothing back."""
        for joint, target in zip(self._arm_joints, rate.tolist(), strict=True):
            joint.set_drive_velocity_target(target)

    def drive_fingers(self, opening: float) -> None:
        """Set both fingers' drive targets, metres each."""
        for joint in self._finger_joints:
            joint.set_drive_target(opening)


def _axis_frame(origin: tuple, axis: str) -> sapien.Pose:
    """A joint frame at `origin` = (xyz, roll) whose x axis, the one SAPIEN moves along, is `axis`."""
    (xyz, roll) = origin
    columns = {
        "z": np.array([[0, -1.0, 0], [0, 0, -1.0], [1.0, 0, 0]]),
        "y": np.array([[0, -1.0, 0], [1.0, 0, 0], [0, 0, 1.0]]),
        "-y": np.array([[0, 1.0, 0], [-1.0, 0, 0], [0, 0, 1.0]]),
    }
    frame = np.eye(4)
    frame[:3, :3] = Shape((0,), (0, 0, 0), roll).rotation @ columns[axis]
    frame[:3, 3] = xyz
    return sapien.Pose(frame)


def _principal_axes(inertial: Inertial) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments and the (4, 4) pose of the principal frame in the link."""
    xy, xz, yz = inertial.products
    tensor = np.diag(inertial.diagonal) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = axes, inertial.centre
    return moments, frame


def _add_shape(link, shape: Shape, material: sapien.physx.PhysxMaterial, *, patch_radius: float) -> None:
    pose = sapien.Pose(shape.pose)
    half = tuple(s / 2 for s in shape.size)
    if len(shape.size) == 3:
        link.add_box_collision(pose, half, material, density=0.0, patch_radius=patch_radius)
        return
    radius, length = shape.size[0], half[1]
    along_z = sapien.Pose(shape.pose @ _X_TO_Z)
    link.add_capsule_collision(along_z, radius, length, material, density=0.0)


_X_TO_Z = np.array([[0, 0, -1.0, 0], [0, 1.0, 0, 0], [1.0, 0, 0, 0], [0, 0, 0, 1.0]])
