"""Further families, after what stands in a household: flattened bottles, wide boxes, thin walls, tools.

Each draws its sizes and returns a solid, metres, as those of `families` do. No shape is measured from
any object; sizes are drawn from the ranges in which such things are sold.
"""

from __future__ import annotations

import math

import numpy as np

from torchgrasp.objects.families import Family
from torchgrasp.objects.flat_things import FLAT_THINGS
from torchgrasp.objects.lofts import Section, loft
from torchgrasp.objects.profiles import rounded_top, smooth, turned, upside_down
from torchgrasp.objects.solids import Profile, Solid, box, join, tube, vessel
from torchgrasp.objects.tools import TOOLS, turn_about_y

_SAGITTA = 0.0015  # metres between a wall's arc and the chord of one part; half of it lies on either side
_AWAY_FROM_X = np.diag((-1.0, -1.0, 1.0))  # half a turn about z
_ON_ITS_SIDE = np.array(((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)))  # a quarter turn about x


def make_flat_bottle(rng: np.random.Generator) -> Solid:
    """A flattened body, a curved shoulder and a neck that may stand off centre, with or without a cap."""
    narrow = rng.uniform(0.02, 0.036)
    half = (min(narrow * rng.uniform(1.15, 2.2), 0.054), narrow)
    power, tall = rng.uniform(2.0, 4.5), rng.uniform(0.12, 0.25)
    neck = rng.uniform(0.011, min(0.019, 0.8 * narrow))
    aside = rng.uniform(-1.0, 1.0) * (half[0] - neck) * 0.6 if rng.random() < 0.3 else 0.0
    top, shoulder = tall * rng.uniform(0.72, 0.86), tall * rng.uniform(0.52, 0.72)
    waist, slope = rng.uniform(0.88, 1.0), rng.uniform(0.9, 1.0)

    def body(z: float, scale: float) -> Section:
        return Section(z, (half[0] * scale, half[1] * scale), power)

    sections = [body(0.0, 0.93), body(0.004, 1.0), body(shoulder / 2, waist), body(shoulder, slope)]
    bend = rng.uniform(1.4, 3.0)  # of the shoulder: 1 is a cone
    for share in (0.35, 0.65, 0.88):
        narrowed = (1 - share**bend) ** (1 / bend)
        sides = [neck + (slope * side - neck) * narrowed for side in half]
        place = (aside * (1 - narrowed), 0.0)
        power_here = 2 + (power - 2) * narrowed
        sections.append(Section(shoulder + share * (top - shoulder), (sides[0], sides[1]), power_here, place))
    round_neck = [(neck, top), (neck, tall)]
    if rng.random() < 0.6:  # a cap, wider than the neck
        wide = neck * rng.uniform(1.05, 1.35)
        low = top + (tall - top) * rng.uniform(0.1, 0.4)
        round_neck = [(neck, top), (neck, low), (wide, low + 0.001), (wide * rng.uniform(0.8, 1.0), tall)]
    sections += [Section(z, (radius, radius), 2.0, (aside, 0.0)) for radius, z in round_neck]
    return loft(sections)


def make_wide_box(rng: np.random.Generator) -> Solid:
    """A box whose narrowest side is nearly as wide as the hand opens: it mostly lies on a wider one."""
    return box((rng.uniform(0.06, 0.073), rng.uniform(0.07, 0.16), rng.uniform(0.10, 0.21)))


def make_flat_box(rng: np.random.Generator) -> Solid:
    """A low box that the hand spans in width, or only stands on edge."""
    return box((rng.uniform(0.025, 0.04), rng.uniform(0.065, 0.09), rng.uniform(0.08, 0.12)))


def make_cup(rng: np.random.Generator) -> Solid:
    """An open can or a tapered cup with walls of 1.5 to 3 mm."""
    radius, height, wall = rng.uniform(0.03, 0.045), rng.uniform(0.06, 0.13), rng.uniform(0.0015, 0.003)
    foot = radius * (1.0 if rng.random() < 0.4 else rng.uniform(0.65, 0.98))
    return _shell([(foot, 0.0), (radius, height)], wall, wall * rng.uniform(1.0, 2.0))


def make_thin_mug(rng: np.random.Generator) -> Solid:
    """A wide mug with walls of 1.5 to 3 mm and a round or square handle."""
    radius, height, wall = rng.uniform(0.036, 0.047), rng.uniform(0.07, 0.11), rng.uniform(0.0015, 0.003)
    foot = radius * rng.uniform(0.85, 1.0)
    body = _shell([(foot, 0.0), (radius, height)], wall, rng.uniform(0.003, 0.006))
    span, level = height * rng.uniform(0.5, 0.75), height * rng.uniform(0.45, 0.55)
    slope = math.atan2(radius - foot, height)
    handle = _handle(rng.uniform(0.022, 0.038), span, rng.uniform(2.0, 3.5))
    grip = tube(handle, rng.uniform(0.008, 0.016), rng.uniform(0.005, 0.009))
    at_wall = foot + (radius - foot) * level / height - wall
    return join(body, grip.moved((at_wall, 0.0, level), turn_about_y(slope)))


def make_thin_bowl(rng: np.random.Generator) -> Solid:
    """A curved bowl with walls of 1.5 to 3 mm, up to 17 cm wide."""
    radius, height, wall = rng.uniform(0.05, 0.085), rng.uniform(0.04, 0.075), rng.uniform(0.0015, 0.003)
    foot, bend = radius * rng.uniform(0.35, 0.6), rng.uniform(1.6, 2.6)
    levels = (0.0, 0.4, 1.0)
    outer = [(foot + (radius - foot) * (1 - (1 - t) ** bend), t * height) for t in levels]
    return _shell(outer, wall, wall * rng.uniform(1.0, 2.0))


def make_pan(rng: np.random.Generator) -> Solid:
    """A low pan with one long handle, or a pot with two ears."""
    radius, wall = rng.uniform(0.05, 0.08), rng.uniform(0.002, 0.003)
    eared = rng.random() < 0.5
    height = radius * (rng.uniform(0.8, 1.3) if eared else rng.uniform(0.5, 0.9))
    foot = radius * rng.uniform(0.85, 1.0)
    body = _shell([(foot, 0.0), (radius, height)], wall, rng.uniform(0.003, 0.005))
    level = height * rng.uniform(0.7, 0.85)
    at_wall = foot + (radius - foot) * level / height - wall - 0.0005
    if eared:
        path = _handle(rng.uniform(0.02, 0.03), rng.uniform(0.045, 0.07), rng.uniform(2.0, 3.0))
        ear = tube(path, rng.uniform(0.007, 0.011), rng.uniform(0.007, 0.011)).moved((0, 0, 0), _ON_ITS_SIDE)
        ear = ear.moved((at_wall - 0.004, 0.0, level))
        return join(body, ear, ear.moved((0, 0, 0), _AWAY_FROM_X))
    length, rise = rng.uniform(0.09, 0.14), rng.uniform(-0.05, 0.25)
    along = np.linspace(0.0, 1.0, 4)
    path = np.stack((at_wall + length * along, 0 * along, level + rise * length * along**1.5), axis=1)
    widths = rng.uniform(0.016, 0.024) * np.linspace(1.0, rng.uniform(0.8, 1.3), 4)
    return join(body, tube(path, widths, rng.uniform(0.009, 0.015), segments=16))


def make_turned(rng: np.random.Generator) -> Solid:
    """A vase, pear, bulb or skittle: a smooth random profile, its ends flat or round."""
    knots, length = int(rng.integers(4, 7)), rng.uniform(0.07, 0.18)
    inner = (np.arange(1, knots - 1) + rng.uniform(-0.3, 0.3, knots - 2)) / (knots - 1)
    heights = length * np.array([0.0, *inner, 1.0])
    radii = rng.uniform(0.011, 0.036, knots)
    profile = smooth(heights.tolist(), radii.tolist())
    if rng.random() < 0.5:
        profile = [*profile, *rounded_top(profile[-1][0], profile[-1][1], radii[-1] * rng.uniform(0.5, 1.0))]
    if rng.random() < 0.3:
        low = rounded_top(radii[0], 0.0, radii[0] * rng.uniform(0.5, 1.0))
        profile = [*upside_down(low), *profile]
    return turned(profile)


def make_goblet(rng: np.random.Generator) -> Solid:
    """A stemmed glass: a foot, a stem and a hollow bowl with walls of 1.5 to 3 mm."""
    radius, height, wall = rng.uniform(0.028, 0.042), rng.uniform(0.05, 0.09), rng.uniform(0.0015, 0.003)
    stem, rise = rng.uniform(0.004, 0.008), rng.uniform(0.03, 0.08)
    bottom, widest = radius * rng.uniform(0.35, 0.6), radius * rng.uniform(1.0, 1.12)
    outer: Profile = [(bottom, 0.0), (widest, height * rng.uniform(0.35, 0.5)), (radius, height)]
    foot, thick = radius * rng.uniform(0.8, 1.05), rng.uniform(0.003, 0.005)
    profile = [(foot, 0.0), (foot, thick), (stem * 1.6, thick + 0.005), (stem, thick + rise / 2)]
    profile += [(stem, thick + rise), (stem * 1.5, thick + rise + 0.01), (bottom * 0.9, thick + rise + 0.014)]
    glass = _shell(outer, wall, rng.uniform(0.004, 0.007))
    return join(turned(profile), glass.moved((0.0, 0.0, profile[-1][1] - 0.001)))


def _shell(outer: Profile, wall: float, floor: float) -> Solid:
    """A vessel with an outside of several levels, a wall of even thickness and a flat floor.

    Its wall has as few parts as stay within 0.8 mm of it: pads that close on several narrow ones slip.
    """
    radii, heights = np.asarray(outer, np.float64).T
    slopes = np.gradient(radii, heights)
    levels = np.array([floor, *heights[1:]])
    inner = np.interp(levels, heights, radii) - wall * np.hypot(1.0, slopes)
    inner[0] = min(inner[0], radii[0])  # the part that stands for the floor is as wide as the foot
    sectors = math.ceil(math.pi / math.acos(1 - _SAGITTA / radii.max()))
    return vessel(outer, list(zip(inner.tolist(), levels.tolist(), strict=True)), sectors=sectors)


def _handle(reach: float, span: float, power: float) -> np.ndarray:
    """(9, 3) path of half a superellipse in the x-z plane from (0, -span / 2) around x = reach."""
    bend = np.linspace(-math.pi / 2, math.pi / 2, 9)
    cosine, sine = np.maximum(np.cos(bend), 0.0), np.sin(bend)
    x, z = reach * cosine ** (2 / power), span / 2 * np.sign(sine) * np.abs(sine) ** (2 / power)
    return np.stack((x, 0 * x, z), axis=1)


# The least probability of resting where grasps are clear, of boxes that mostly lie as no hand spans them.
LEAST_AT_REST: dict[str, float] = {"wide_box": 0.1, "flat_box": 0.1}

HOUSEHOLD: dict[str, Family] = {
    "flat_bottle": make_flat_bottle,
    "wide_box": make_wide_box,
    "flat_box": make_flat_box,
    "cup": make_cup,
    "thin_mug": make_thin_mug,
    "thin_bowl": make_thin_bowl,
    "pan": make_pan,
    "turned": make_turned,
    "goblet": make_goblet,
    **FLAT_THINGS,
    **TOOLS,
}
