"""Families of flat outlines drawn out to a height: crescents, stars, letters, polygons."""

from __future__ import annotations

import math

import numpy as np

from torchgrasp.objects.families import Family
from torchgrasp.objects.prisms import prism, rounded, star, strip
from torchgrasp.objects.solids import Points, Solid, tube


def arc(radius: float, start: float, end: float, steps: int) -> Points:
    """(steps + 1, 2) points of a circle about the origin between two angles."""
    angles = np.linspace(start, end, steps + 1)
    return radius * np.stack((np.cos(angles), np.sin(angles)), axis=1)


def make_crescent(rng: np.random.Generator) -> Solid:
    """A flat bow, pointed or blunt."""
    radius, half = rng.uniform(0.035, 0.07), rng.uniform(0.7, 1.5)
    middle, end = rng.uniform(0.018, 0.04), rng.uniform(0.15, 1.0)
    path = arc(radius, -half, half, 12)
    along = np.linspace(-1.0, 1.0, 13)
    widths = middle * (end + (1 - end) * np.sqrt(1.05 - along**2))
    return strip(path - path.mean(0), widths, rng.uniform(0.016, 0.04), taper=rng.uniform(0.85, 1.0))


def make_banana(rng: np.random.Generator) -> Solid:
    """A bent round body that narrows towards both ends."""
    radius, half = rng.uniform(0.06, 0.14), rng.uniform(0.5, 0.9)
    half = min(half, 0.1 / radius)
    path = arc(radius, -half, half, 12)
    along = np.linspace(-1.0, 1.0, 13)
    thick = rng.uniform(0.028, 0.044) * (0.25 + 0.75 * np.sqrt(1 - np.abs(along) ** rng.uniform(2.5, 5.0)))
    bent = np.stack((path[:, 0], 0 * along, path[:, 1]), axis=1)
    return tube(bent, thick * rng.uniform(0.8, 1.0), thick, segments=16)


def make_star(rng: np.random.Generator) -> Solid:
    """Three to five arms, pointed or blunt, about a middle."""
    arms = int(rng.integers(3, 6))
    angles = (np.arange(arms) + rng.uniform(-0.12, 0.12, arms)) * 2 * math.pi / arms
    radius = rng.uniform(0.012, 0.024)
    lengths = rng.uniform(0.02, 0.05) * rng.uniform(0.7, 1.0, arms)
    height, tips = rng.uniform(0.024, 0.045), rng.uniform(0.15, 1.0)
    return star(angles, radius, lengths.tolist(), tips, height, taper=rng.uniform(0.85, 1.0))


def make_letter(rng: np.random.Generator) -> Solid:
    """A bar in the form of an L, T, U or Z."""
    width, height = rng.uniform(0.014, 0.03), rng.uniform(0.016, 0.045)
    a, b, c = rng.uniform(0.03, 0.08, 3)
    taper = rng.uniform(0.9, 1.0)
    form = "LTUZ"[int(rng.integers(4))]
    if form == "T":
        quarters = np.arange(4) * math.pi / 2
        return star(quarters, width / math.sqrt(2), [a, b, c, 0.0], 1.0, height, taper=taper)
    across = max(b, width + 0.025)  # a finger fits between the legs of a U
    path = {
        "L": [(a, 0.0), (0.0, 0.0), (0.0, b)],
        "U": [(a, 0.0), (0.0, 0.0), (0.0, across), (c, across)],
        "Z": [(-a, 0.0), (0.0, 0.0), (0.0, across), (c, across)],
    }[form]
    corners = np.array(path)
    return strip(corners - corners.mean(0), width, height, taper=taper)


def make_polygon(rng: np.random.Generator) -> Solid:
    """A convex polygon of four to eight rounded corners, flat or tall, tapered."""
    count = int(rng.integers(4, 9))
    angles = (np.arange(count) + rng.uniform(-0.15, 0.15, count)) * 2 * math.pi / count
    half = rng.uniform(0.018, 0.036) * np.array((1.0, rng.uniform(0.8, 1.0)))
    radius = half.min() * rng.uniform(0.15, 0.4)
    corners = np.stack((np.cos(angles), np.sin(angles)), axis=1) * (half - radius)
    outline = rounded(corners, radius)
    tall = rng.uniform(0.03, 0.14)
    steepest = max(0.6, 1 - 0.18 * tall / half.max())  # two pads still hold on to the sides
    return prism(outline, [range(len(outline))], tall, taper=rng.uniform(steepest, 1.0))


FLAT_THINGS: dict[str, Family] = {
    "crescent": make_crescent,
    "banana": make_banana,
    "star": make_star,
    "letter": make_letter,
    "polygon": make_polygon,
}
