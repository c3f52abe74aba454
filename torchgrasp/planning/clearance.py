"""How far a posture is from table, object and itself, and which way leads out: batched over postures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.distance import DistanceField, distance_field
from torchgrasp.planning.spheres import HAND, arm_spheres, column_colliders, column_spheres, self_pairs
from torchgrasp.sim.kinematics import Array, link_poses

_FAR = 0.05


@dataclass(frozen=True)
class Clearance:
    """Distances between the arm's spheres and what they must not touch in one scene.

    Attributes:
        field: signed distance of the object, object frame.
        T_base_object: (4, 4) its pose.
        margin: metres of clearance from which on a posture costs nothing (the epsilon of CHOMP).
    """

    field: DistanceField
    T_base_object: Array
    margin: float = 0.02

    @classmethod
    def of(cls, target: GraspObject, T_base_object: Array, *, margin: float = 0.02) -> Clearance:
        """For an object at its (4, 4) pose."""
        return cls(distance_field(target), T_base_object, margin)

    def distances(self, q: Array, *, hand: bool = True) -> Array:
        """(B,) smallest clearance of postures (B, 7), metres, negative where something touches.

        Clearances of more than 5 cm from the object count as 5 cm.

        Args:
            q: arm angles.
            hand: whether hand and fingers count against the object; where a grasp is near, boxes tell more.
        """
        spheres = arm_spheres()
        centres = spheres.place(link_poses(q))
        nearest = (centres[..., 2] - spheres.radius).min(axis=-1)
        nearest = np.minimum(nearest, _column_pairs(centres).min(axis=(1, 2)))
        nearest = np.minimum(nearest, _moving_pairs(centres).min(axis=-1))
        row, sphere = self._near(centres, _FAR)
        if not hand:
            row, sphere = row[spheres.link[sphere] != HAND], sphere[spheres.link[sphere] != HAND]
        clear, _ = self._to_object(centres[row, sphere])
        to_object = np.full(len(q), _FAR)
        np.minimum.at(to_object, row, clear - spheres.radius[sphere])
        return np.minimum(nearest, to_object)

    def cost(self, q: Array) -> tuple[Array, Array]:
        """(B,) cost of postures (B, 7) and its gradient (B, 7) with respect to the angles.

        A sphere costs nothing beyond `margin`, a quadratic share of it closer by, and grows linearly
        where it penetrates (Zucker et al. 2013, CHOMP, Eq. 21).
        """
        spheres, poses = arm_spheres(), link_poses(q)
        centres = spheres.place(poses)
        force = np.zeros(centres.shape)
        cost, force[..., 2] = self._hinge(centres[..., 2] - spheres.radius)
        total = cost.sum(axis=-1)

        row, sphere = self._near(centres, self.margin)
        distance, slope = self._to_object(centres[row, sphere])
        cost, push = self._hinge(distance - spheres.radius[sphere])
        total += np.bincount(row, cost, len(q))
        force[row, sphere] += push[:, None] * slope

        total += self._push_apart(centres, force)
        return total, _torques(poses, centres, force, spheres.moved_by)

    def _hinge(self, distance: Array) -> tuple[Array, Array]:
        """CHOMP's cost of distances, and its derivative."""
        short = np.maximum(self.margin - distance, 0.0)
        deep = distance < 0.0
        cost = np.where(deep, self.margin / 2 - distance, short**2 / (2 * self.margin))
        return cost, -np.where(deep, 1.0, short / self.margin)

    def _near(self, centres: Array, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows and spheres that come within `reach` of the ball around the object."""
        apart = centres - self.T_base_object[:3, 3]
        limit = self.field.radius + reach + arm_spheres().radius
        row, sphere = np.nonzero((apart * apart).sum(axis=-1) < limit**2)
        return row, sphere

    def _to_object(self, centres: Array) -> tuple[Array, Array]:
        """Signed distance (N,) of points (N, 3) and its gradient (N, 3), base frame."""
        rotation, position = self.T_base_object[:3, :3], self.T_base_object[:3, 3]
        distance, slope = self.field.sample((centres - position) @ rotation)
        return distance, slope @ rotation.T

    def _push_apart(self, centres: Array, force: Array) -> Array:
        """(B,) cost of the arm's own collisions; adds the forces of them to `force`."""
        total = np.zeros(len(centres))
        fixed, _ = column_spheres()
        row, sphere, column = np.nonzero((clear := _column_pairs(centres)) < self.margin)
        cost, push = self._hinge(clear[row, sphere, column])
        sphere = column_colliders()[sphere]
        away = _unit(centres[row, sphere] - fixed[column])
        np.add.at(force, (row, sphere), push[:, None] * away)
        total += np.bincount(row, cost, len(total))

        row, pair = np.nonzero((clear := _moving_pairs(centres)) < self.margin)
        cost, push = self._hinge(clear[row, pair])
        first, second = (spheres[pair] for spheres in self_pairs())
        pull = push[:, None] * _unit(centres[row, first] - centres[row, second])
        np.add.at(force, (row, first), pull)
        np.add.at(force, (row, second), -pull)
        return total + np.bincount(row, cost, len(total))


def _column_pairs(centres: Array) -> Array:
    """Clearances (B, M, C) of the spheres that may meet base or shoulder."""
    fixed, fixed_radius = column_spheres()
    moving = column_colliders()
    at = centres[:, moving]
    square = (at * at).sum(axis=-1)[..., None] - 2.0 * (at @ fixed.T) + (fixed * fixed).sum(axis=-1)
    return np.sqrt(np.maximum(square, 0.0)) - (arm_spheres().radius[moving, None] + fixed_radius)


def _moving_pairs(centres: Array) -> Array:
    """Clearances (B, M) of the pairs of spheres that both move."""
    first, second = self_pairs()
    square = (centres * centres).sum(axis=-1)
    inner = (centres @ centres.transpose(0, 2, 1)).reshape(len(centres), -1)
    product = inner[:, first * centres.shape[1] + second]
    radius = arm_spheres().radius
    apart = square[:, first] + square[:, second] - 2.0 * product
    return np.sqrt(np.maximum(apart, 0.0)) - (radius[first] + radius[second])


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _torques(poses: Array, centres: Array, force: Array, moved_by: Array) -> Array:
    """(B, 7) what forces (B, P, 3) on the spheres do about each joint: Jacobian transpose."""
    axes, origins = poses[:, :7, :3, 2], poses[:, :7, :3, 3]
    total = moved_by @ force
    moment = moved_by @ _cross(centres, force) - _cross(origins, total)
    return (axes * moment).sum(axis=-1)


def _cross(a: Array, b: Array) -> Array:
    """Cross products along the last axis; np.cross takes long over its arguments."""
    after, later = (1, 2, 0), (2, 0, 1)
    return a[..., after] * b[..., later] - a[..., later] * b[..., after]
