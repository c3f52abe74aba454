"""The arm and the open hand as spheres: what a trajectory keeps clear of table, object and itself."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from torchgrasp.sim.kinematics import JOINT_ORIGINS, Array
from torchgrasp.sim.panda_tables import ARM_SHAPES, IGNORE_BITS, Shape

HAND = 7  # index of the hand among the poses of `kinematics.link_poses`
# Hand and fingers; a fingertip's sphere is no wider than its pad, the gap between the pads stays open.
_HAND_SPHERES = (
    *(((0.0, y, z), 0.042) for y in (-0.07, -0.023, 0.023, 0.07) for z in (0.0, 0.028)),
    *(((0.0, y, z), 0.011) for y in (-0.052, 0.052) for z in (0.075, 0.098)),
)


@dataclass(frozen=True)
class Spheres:
    """P spheres fixed to links.

    Attributes:
        link: (P,) index into the poses of `kinematics.link_poses`: 0 to 6 links 1 to 7, 7 the hand.
        centre: (P, 3) in the link's frame, metres.
        radius: (P,) metres.
        moved_by: (7, P) 1 where joint j moves the sphere, else 0.
    """

    link: np.ndarray
    centre: Array
    radius: Array
    moved_by: Array

    def place(self, poses: Array) -> Array:
        """(B, 8, 4, 4) link poses to the (B, P, 3) centres in the base."""
        at = poses[:, self.link]
        return (at[..., :3, :3] @ self.centre[..., None])[..., 0] + at[..., :3, 3]


@functools.cache
def arm_spheres() -> Spheres:
    """Links 2 to 7 and the open hand."""
    link, centre, radius = [], [], []
    for number in range(2, 8):
        for shape in ARM_SHAPES[number]:
            for position in _along(shape):
                link.append(number - 1)
                centre.append(position)
                radius.append(shape.size[0])
    for position, size in _HAND_SPHERES:
        link.append(HAND)
        centre.append(np.array(position))
        radius.append(size)
    links = np.array(link)
    moved_by = (links[None, :] >= np.arange(7)[:, None]).astype(np.float64)
    return Spheres(links, np.array(centre), np.array(radius), moved_by)


@functools.cache
def column_spheres() -> tuple[Array, Array]:
    """(C, 3) centres in the base and (C,) radii of base and shoulder, which stand still.

    Link 1 turns about its own axis of symmetry.
    """
    base, (shoulder,) = ARM_SHAPES[0][0], ARM_SHAPES[1]
    centres = [np.array((x, 0.0, 0.07)) for x in (-0.08, 0.0)]
    radii = [base.size[1] / 2] * 2
    height = np.array(JOINT_ORIGINS[0][0])
    for position in _along(shoulder):
        centres.append(position + height)
        radii.append(shoulder.size[0])
    return np.array(centres), np.array(radii)


@functools.cache
def self_pairs() -> tuple[np.ndarray, np.ndarray]:
    """Pairs of moving spheres (M,), (M,) whose links may collide, as the simulated Panda's do."""
    spheres = arm_spheres()
    first, second = np.nonzero(_may_collide(spheres.link[:, None] + 1, spheres.link[None, :] + 1))
    keep = first < second
    return first[keep], second[keep]


@functools.cache
def column_colliders() -> np.ndarray:
    """Indices of the moving spheres that may collide with base or shoulder."""
    return np.flatnonzero(_may_collide(arm_spheres().link + 1, np.array(0)))


def _may_collide(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    bits = np.array([IGNORE_BITS["hand" if number == 8 else f"link{number}"] for number in range(9)])
    return (bits[first] & bits[second]) == 0


def _along(capsule: Shape) -> list[Array]:
    """Centres along a capsule's axis, at most its radius apart."""
    radius, length = capsule.size[0], capsule.size[1]
    count = 1 + int(np.ceil(length / radius))
    axis = capsule.rotation @ np.array((0.0, 0.0, 1.0))
    return [np.array(capsule.position) + s * axis for s in np.linspace(-length / 2, length / 2, count)]
