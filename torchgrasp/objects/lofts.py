"""Solids through cross sections that are superellipses: bottles, grips, what is round at one end alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from torchgrasp.objects.solids import Points, Solid, tube_faces

_SURFACE_POINTS = 64  # of a cross section
_PART_POINTS = 32  # two of them are a convex part's 64 vertices


@dataclass(frozen=True)
class Section:
    """The superellipse |x / half[0]|**power + |y / half[1]|**power = 1 at height z, metres.

    Attributes:
        z: height.
        half: half axes along x and y.
        power: 2 is an ellipse, 4 and more a rounded rectangle; above 1.
        centre: (x, y) of its middle.
    """

    z: float
    half: tuple[float, float]
    power: float = 2.0
    centre: tuple[float, float] = (0.0, 0.0)

    def normals(self, count: int) -> Points:
        """(count, 2) outward directions, not of unit length, denser where the outline turns faster."""
        angles = np.arange(count) * 2 * np.pi / count
        around = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        around[np.abs(around) < 1e-12] = 0.0
        return np.sign(around) * np.abs(around) ** (2 - 2 / self.power) / np.asarray(self.half)

    def support(self, normals: Points) -> Points:
        """(N, 3) points of the outline where its normal has the directions (N, 2)."""
        dual = self.power / (self.power - 1)
        scaled = np.abs(normals) * self.half
        scaled /= (scaled**dual).sum(1, keepdims=True) ** (1 / dual)
        flat = np.sign(normals) * scaled ** (dual - 1) * self.half + np.asarray(self.centre)
        return np.column_stack((flat, np.full(len(flat), self.z)))

    def grown(self, normals: Points) -> Points:
        """(N, 3) corners of a polygon that lies as far outside the outline as inside; cf. `chord_gain`."""
        corners = self.support(normals)
        middles = (corners + np.roll(corners, 1, axis=0))[:, :2] / 2
        inner = (np.abs((middles - self.centre) / self.half) ** self.power).sum(1) ** (1 / self.power)
        corners[:, :2] += (corners[:, :2] - self.centre) * (2 / (1 + inner.min()) - 1)
        return corners


def loft(sections: Sequence[Section]) -> Solid:
    """The closed solid through the sections, from the bottom upwards: a convex part between each two.

    Points with the same normal are joined, so that what lies between two sections is exactly their
    convex hull.
    """
    widest = max(sections, key=lambda section: section.half[0] * section.half[1])
    rings = [section.support(widest.normals(_SURFACE_POINTS)) for section in sections]
    coarse = [section.grown(widest.normals(_PART_POINTS)) for section in sections]
    faces = tube_faces(len(sections), _SURFACE_POINTS)[:, ::-1]
    parts = tuple(np.concatenate(pair) for pair in pairwise(coarse))
    return Solid(np.concatenate(rings), faces, parts)
