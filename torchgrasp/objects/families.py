"""Families of procedural objects: each draws its sizes and returns a solid, metres.

Each is of a tabletop size with some side that an 8 cm gripper spans; the tests check that every one
drawn has at least a hundred grasps. HELD_OUT families occur in the test split only.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from torchgrasp.objects.profiles import upside_down
from torchgrasp.objects.solids import Profile, Solid, box, chord_gain, cylinder, join, lathe, tube, vessel

Family = Callable[[np.random.Generator], Solid]


def make_box(rng: np.random.Generator) -> Solid:
    """A box with one side of at most 6.5 cm."""
    return box((rng.uniform(0.02, 0.065), rng.uniform(0.03, 0.10), rng.uniform(0.05, 0.18)))


def make_cylinder(rng: np.random.Generator) -> Solid:
    """A can or rod."""
    return cylinder(rng.uniform(0.015, 0.034), rng.uniform(0.05, 0.18))


def make_capsule(rng: np.random.Generator) -> Solid:
    """A cylinder with hemispheres on both ends."""
    radius, half = rng.uniform(0.015, 0.034), rng.uniform(0.015, 0.06)
    fine = [(r * radius, z * radius + half) for r, z in _arc(0.0, math.pi / 2, 10)]
    cap = [(r * radius, z * radius + half) for r, z in _arc(0.0, math.pi / 2, 3, gain=True)]
    bands = [upside_down(cap), [(radius, -half), (radius, half)], cap]
    return lathe(upside_down(fine) + fine, bands)


def make_ellipsoid(rng: np.random.Generator) -> Solid:
    """An ellipsoid of three unequal half axes."""
    steps = _arc(0.0, math.pi / 2, 4, gain=True)
    bands = [steps[:3], steps[2:]]
    sphere = lathe(_arc(-math.pi / 2, math.pi / 2, 24), [*bands, *map(upside_down, bands)])
    return sphere.scaled((rng.uniform(0.018, 0.033), rng.uniform(0.022, 0.045), rng.uniform(0.035, 0.075)))


def make_bottle(rng: np.random.Generator) -> Solid:
    """A cylinder, a conical shoulder and a neck."""
    radius, neck = rng.uniform(0.022, 0.034), rng.uniform(0.010, 0.016)
    levels = np.cumsum([0.0, rng.uniform(0.06, 0.12), rng.uniform(0.012, 0.03), rng.uniform(0.015, 0.04)])
    profile = list(zip((radius, radius, neck, neck), levels.tolist(), strict=True))
    return lathe(profile, [profile[i : i + 2] for i in range(3)])


def make_bowl(rng: np.random.Generator) -> Solid:
    """A bowl with a foot, a flare and a steeper wall of 3 to 6 mm: held at the rim."""
    radius, height, wall = rng.uniform(0.05, 0.075), rng.uniform(0.04, 0.065), rng.uniform(0.003, 0.006)
    foot, shoulder, level = rng.uniform(0.4, 0.55), rng.uniform(0.84, 0.92), rng.uniform(0.4, 0.5)
    outer = [(foot * radius, 0.0), (shoulder * radius, level * height), (radius, height)]
    lift = wall * 1.3  # across a flare, a wall measured upright looks thicker than it is
    inner = [
        (foot * radius - wall, wall),
        (outer[1][0] - wall, outer[1][1] + lift - wall),
        (radius - wall, height),
    ]
    return vessel(outer, inner, sectors=14)


def make_mug(rng: np.random.Generator) -> Solid:
    """A straight mug with a bent handle."""
    radius, height = rng.uniform(0.032, 0.042), rng.uniform(0.07, 0.11)
    wall, floor = rng.uniform(0.003, 0.0055), rng.uniform(0.004, 0.007)
    body = vessel(
        [(radius, 0.0), (radius, height)], [(radius - wall, floor), (radius - wall, height)], sectors=12
    )
    reach, span = rng.uniform(0.025, 0.038), height * rng.uniform(0.5, 0.7)
    bend = np.linspace(-math.pi / 2, math.pi / 2, 7)
    path = np.stack(
        (radius - wall / 2 + reach * np.cos(bend), 0 * bend, span / 2 * np.sin(bend) + height / 2), 1
    )
    return join(body, tube(path, rng.uniform(0.008, 0.014), rng.uniform(0.006, 0.009)))


def make_bracket(rng: np.random.Generator) -> Solid:
    """Two plates joined at a right angle."""
    depth, thick = rng.uniform(0.025, 0.06), rng.uniform(0.012, 0.03)
    foot, wall = rng.uniform(0.06, 0.13), rng.uniform(0.04, 0.09)
    upright = box((thick, depth, wall)).moved(((thick - foot) / 2, 0.0, (thick + wall) / 2))
    return join(box((foot, depth, thick)), upright)


def make_hammer(rng: np.random.Generator) -> Solid:
    """A round handle in a block."""
    radius, length = rng.uniform(0.009, 0.015), rng.uniform(0.10, 0.15)
    head = (rng.uniform(0.06, 0.10), rng.uniform(0.024, 0.036), rng.uniform(0.024, 0.036))
    return join(cylinder(radius, length), box(head).moved((0.0, 0.0, (length + head[2]) / 2)))


def make_dumbbell(rng: np.random.Generator) -> Solid:
    """A bar between two discs."""
    bar, radius = rng.uniform(0.009, 0.014), rng.uniform(0.022, 0.034)
    half, thick = rng.uniform(0.03, 0.05), rng.uniform(0.012, 0.03)
    side = [(bar, half), (radius, half), (radius, half + thick)]
    bands: list[Profile] = [[(bar, -half), (bar, half)], side[1:], upside_down(side[1:])]
    return lathe(upside_down(side) + side, bands)


TRAINED: dict[str, Family] = {
    "box": make_box,
    "cylinder": make_cylinder,
    "capsule": make_capsule,
    "bottle": make_bottle,
    "bowl": make_bowl,
    "mug": make_mug,
    "ellipsoid": make_ellipsoid,
    "bracket": make_bracket,
}
HELD_OUT: dict[str, Family] = {"hammer": make_hammer, "dumbbell": make_dumbbell}
FAMILIES: dict[str, Family] = {**TRAINED, **HELD_OUT}


def _arc(low: float, high: float, steps: int, *, gain: bool = False) -> list[tuple[float, float]]:
    """(radius, z) of a unit circle between latitudes; with `gain`, chords err as much in as out."""
    scale = chord_gain((high - low) / steps) if gain else 1.0
    latitudes = np.linspace(low, high, steps + 1)
    radii = np.where(np.isclose(abs(latitudes), math.pi / 2), 0.0, np.cos(latitudes))
    return [(float(r), float(z)) for r, z in zip(radii * scale, np.sin(latitudes) * scale, strict=True)]
