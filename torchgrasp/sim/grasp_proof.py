"""Whether a grasp holds in physics, with nothing else in the way: no approach, no table, no reach."""

from __future__ import annotations

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import kinematics
from torchgrasp.sim.physics import Physics
from torchgrasp.sim.sapien_world import SapienWorld
from torchgrasp.sim.world import LIFTED, Placement


def grasp_holds(target: GraspObject, T_object_ee: np.ndarray, physics: Physics) -> bool:
    """Close the open hand on an object that is held in the air, let it go and lift; whether it came along.

    Args:
        target: the object.
        T_object_ee: (4, 4) the grasp.
        physics: what the world is made of.
    """
    q = kinematics.READY_POSTURE
    T_base_ee = kinematics.forward_kinematics(q[None])[0]
    T_base_object = T_base_ee @ np.linalg.inv(np.asarray(T_object_ee, np.float64))
    world = SapienWorld(Placement(target, T_base_object, q, physics, held=True))
    world.close_fingers()
    before = world.T_base_object[2, 3]
    for _ in world.lift():
        pass
    return bool(world.T_base_object[2, 3] - before > LIFTED)
