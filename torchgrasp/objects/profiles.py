"""Profiles of turned things: smooth random ones, and the convex bands that stand for any of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

from torchgrasp.objects.solids import Points, Profile, Solid, lathe

_TOLERANCE = 0.0006  # metres by which a band's straight side may miss the profile
_STEPS = 24  # of a smooth profile
_CAP_STEPS = 8  # of a rounded end
_MOST_RINGS = 3  # of a band: its 64 vertices are 21 around then


def turned(profile: Profile) -> Solid:
    """The full solid of revolution of a (radius, z) profile whose z never falls."""
    return lathe(profile, list(bands(profile)))


def smooth(heights: Sequence[float], radii: Sequence[float]) -> list[tuple[float, float]]:
    """(radius, z) through the given ones, without a bump between two of them (monotone cubic pieces)."""
    levels = np.linspace(heights[0], heights[-1], _STEPS + 1)
    curve = PchipInterpolator(heights, radii)(levels)
    return [(float(r), float(z)) for r, z in zip(curve, levels, strict=True)]


def rounded_top(radius: float, z: float, height: float) -> list[tuple[float, float]]:
    """(radius, z) of half an ellipse upon a circle of `radius` at z, which is left out, up to the axis."""
    angles = np.arange(1, _CAP_STEPS + 1) * math.pi / 2 / _CAP_STEPS
    arc = [(float(radius * math.cos(a)), float(z + height * math.sin(a))) for a in angles]
    return [*arc[:-1], (0.0, z + height)]


def upside_down(profile: Profile) -> list[tuple[float, float]]:
    """A profile reflected in z = 0, again from the bottom upwards."""
    return [(r, -z) for r, z in reversed(profile)]


def bands(profile: Profile) -> Iterator[Profile]:
    """Convex bands, of at most three rings each, that follow the profile within 0.6 mm."""
    points = np.asarray(profile, np.float64)
    corners = points[[0, *_corners(points, 0, len(points) - 1), len(points) - 1]]
    band = [corners[0]]
    for i, corner in enumerate(corners[1:], start=1):
        if corner[1] - corners[i - 1][1] < 1e-6:  # a step: all that is below it is done
            if len(band) > 1:
                yield [(float(r), float(z)) for r, z in band]
            band = [corner]
            continue
        full = corner[0] > 0 and sum(ring[0] > 0 for ring in band) == _MOST_RINGS
        if full or (len(band) > 1 and not _bulges(band[-2], band[-1], corner)):
            yield [(float(r), float(z)) for r, z in band]
            band = [band[-1]]
        band.append(corner)
    if len(band) > 1:
        yield [(float(r), float(z)) for r, z in band]


def _bulges(first: Points, second: Points, third: Points) -> bool:
    """Whether a profile turns towards the axis at the second of three points."""
    below, above = second - first, third - second
    return bool(below[0] * above[1] - below[1] * above[0] > 0)


def _corners(points: Points, first: int, last: int) -> list[int]:
    """Indices between two points of a polyline that must stay (Douglas and Peucker, 1973)."""
    chord = points[last] - points[first]
    between = points[first + 1 : last] - points[first]
    if not len(between):
        return []
    away = np.abs(chord[0] * between[:, 1] - chord[1] * between[:, 0]) / np.linalg.norm(chord)
    if away.max() < _TOLERANCE:
        return []
    middle = first + 1 + int(away.argmax())
    return [*_corners(points, first, middle), middle, *_corners(points, middle, last)]
