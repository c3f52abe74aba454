"""Whether the open hand, box by box, meets the object or the table."""

from __future__ import annotations

import numpy as np

from torchgrasp.objects.gripper import hand_blocked, lowest_point
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.surface import surface_points
from torchgrasp.planning.clearance import Clearance
from torchgrasp.sim.kinematics import Array, forward_kinematics

# Metres that things may sink into each other at the start: contact is no collision.
_CONTACT = 0.01
# The same of the arm's spheres, which are thicker than folded links.
_OVERLAP = 0.04
_SLACK = 0.005


def hand_is_free(target: GraspObject, T_base_object: Array, T_base_ee: Array) -> np.ndarray:
    """(K,) whether the hand comes along its ways (K, S, 4, 4) without meeting object or table.

    A hand that touches where it stands (the first pose) is free to leave: touches count from the first
    pose without one.
    """
    T_object_ee = np.linalg.solve(T_base_object, T_base_ee.reshape(-1, 4, 4))
    touched = hand_blocked(surface_points(target), T_object_ee, approach=0.0).reshape(T_base_ee.shape[:2])
    touched |= lowest_point(T_base_ee) <= 0.0
    left = np.maximum.accumulate(~touched, axis=-1)
    return np.asarray(~(touched & left).any(axis=-1) & left[:, -1])


def starts_inside(target: GraspObject, T_base_object: Array, q: Array, clearance: Clearance) -> bool:
    """Whether arm or hand at q (7,) is so deep in object, table or the arm itself that no plan can begin."""
    T_base_ee = forward_kinematics(q[None])
    T_object_ee = np.linalg.solve(T_base_object, T_base_ee[0])[None]
    inside = hand_blocked(surface_points(target), T_object_ee, approach=0.0, margin=-_CONTACT)[0]
    low = lowest_point(T_base_ee)[0] < -_CONTACT
    return bool(inside or low or clearance.distances(q[None], hand=False)[0] < -_OVERLAP)


def arm_is_free(clearance: Clearance, q: Array) -> np.ndarray:
    """(K,) whether the arm comes along its ways (K, S, 7), S > 1, without touching anything.

    The hand is left to `hand_is_free`. An arm that touches where it stands may not get deeper.
    """
    apart = clearance.distances(q.reshape(-1, 7), hand=False).reshape(q.shape[:2])
    limit = np.minimum(-_SLACK, apart[:, :1] - _SLACK)
    return np.asarray((apart[:, 1:] > limit).all(axis=-1))
