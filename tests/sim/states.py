"""States of a world for cameras to look at."""

from collections.abc import Iterator, Sequence

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import CameraIntrinsics, View, look_at
from torchgrasp.sim import kinematics as kin

OVERHEAD = {
    "intrinsics": CameraIntrinsics(112, 112, fov=1.0, near=0.1, far=3.0),
    "T_base_camera": look_at((1.4, 0.0, 0.9), (0.5, 0.0, 0.15)),
}


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    return turn


def views(targets: Sequence[GraspObject], count: int, seed: int = 0) -> Iterator[View]:
    """States above the table, the object before the hand: postures near the ready one and, by turns, any."""
    rng = np.random.default_rng(seed)
    given = 0
    while given < count:
        q = kin.READY_POSTURE + rng.uniform(-0.5, 0.5, 7)
        if given % 2:
            q = rng.uniform(kin.JOINT_LOWER, kin.JOINT_UPPER)
        T_base_object = np.eye(4)
        T_base_object[:3, :3] = random_rotation(rng)
        T_base_ee = kin.forward_kinematics(q[None])[0]
        T_base_object[:3, 3] = T_base_ee[:3] @ (*rng.uniform((-0.1, -0.1, 0.05), (0.1, 0.1, 0.4)), 1.0)
        if min(T_base_ee[2, 3], T_base_object[2, 3]) > 0.12:
            joints = np.concatenate((q, rng.uniform(0.0, 0.04, 2).round(4)))
            yield View(targets[given % len(targets)], T_base_object, joints, T_base_ee, given)
            given += 1
