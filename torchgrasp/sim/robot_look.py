"""How the robot looks: as the shapes that collide, or as the Panda's own meshes where they are installed.

What policies see are the shapes, as physics has them. People are shown the meshes.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.sim.panda_meshes import meshes_folder, read_meshes
from torchgrasp.sim.panda_pose import ARM_SIZES, HAND_SIZES, arm_poses, half_extents, hand_poses
from torchgrasp.sim.scene_parts import Part
from torchgrasp.sim.visuals import box_visual, capsule_visual

RobotLookName = Literal["shapes", "meshes"]
_DARK, _METAL = (0.12, 0.12, 0.13), (0.75, 0.75, 0.78)


@dataclass(frozen=True, eq=False)
class RobotLook:
    """The parts that the robot is drawn of, and where they are.

    Attributes:
        name: "shapes" or "meshes".
        parts: the P parts.
        poses: from joints (9,) and the hand's pose (4, 4) to the parts' (P, 4, 4) poses, base frame.
    """

    name: RobotLookName
    parts: tuple[Part, ...]
    poses: Callable[[NDArray, NDArray], NDArray]


@functools.cache
def robot_look(name: RobotLookName) -> RobotLook:
    """The look of this name, made at the first call; "meshes" by `mesh_look` of an installed pybullet."""
    check_robot(name)
    return RobotLook("shapes", _shapes(), _shape_poses) if name == "shapes" else mesh_look(meshes_folder())


def mesh_look(folder: Path | None) -> RobotLook:
    """The look by the meshes in a folder.

    The shapes serve where there is no folder, and where one of its files cannot be used, with a warning.
    """
    if folder is not None:
        try:
            meshes = read_meshes(folder)
            return RobotLook("meshes", meshes.parts, meshes.poses)
        except ObjectError as error:
            warnings.warn(f"The robot is shown by its shapes: {error}", stacklevel=3)
    return robot_look("shapes")


def check_robot(robot: str) -> None:
    """Raise ConfigError for what is the name of no look."""
    if robot not in get_args(RobotLookName):
        raise ConfigError(f"robot={robot!r}: give one of {', '.join(get_args(RobotLookName))}.")


def _shapes() -> tuple[Part, ...]:
    """The shapes that collide, in the order of `panda_pose.arm_poses`, then `hand_poses`."""
    parts = []
    for index, size in enumerate((*ARM_SIZES, *HAND_SIZES)):
        visual = box_visual(half_extents(size)) if len(size) == 3 else capsule_visual(*size)
        parts.append(Part(visual, _shape_colour(index), roughness=0.5, specular=0.4))
    return tuple(parts)


def _shape_poses(joints: NDArray, T_base_ee: NDArray) -> NDArray:
    return np.concatenate((arm_poses(joints[:7]), hand_poses(T_base_ee, joints[7:])))


def _shape_colour(index: int) -> tuple[float, float, float]:
    """White links, dark joints of the elbow and wrist, a dark hand with metal fingers."""
    if index < len(ARM_SIZES):
        return (0.9, 0.9, 0.92) if index % 2 else (0.72, 0.74, 0.77)
    return _DARK if index == len(ARM_SIZES) else _METAL
