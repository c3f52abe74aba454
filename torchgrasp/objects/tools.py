"""Families of tools and of primitives joined at random."""

from __future__ import annotations

import math

import numpy as np
import roma
import torch

from torchgrasp.objects.families import Family
from torchgrasp.objects.flat_things import arc
from torchgrasp.objects.lofts import Section, loft
from torchgrasp.objects.prisms import prism, rounded, strip
from torchgrasp.objects.profiles import rounded_top, smooth, turned, upside_down
from torchgrasp.objects.solids import Points, Solid, box, cylinder, join

_LONGEST = 0.2  # metres of a compound


def make_drill(rng: np.random.Generator) -> Solid:
    """A power drill: a body with a chuck, a grip below it and a foot."""
    radius, length = rng.uniform(0.022, 0.032), rng.uniform(0.10, 0.14)
    chuck, nose = rng.uniform(0.010, 0.018), rng.uniform(0.025, 0.045)
    profile = [(radius * rng.uniform(0.7, 1.0), 0.0), (radius, length * 0.15), (radius, length * 0.8)]
    profile += [(chuck * 1.1, length), (chuck, length + nose * 0.6), (chuck * 0.5, length + nose)]
    barrel = turned(profile).moved((-length * 0.4, 0.0, 0.0), turn_about_y(math.pi / 2))
    wide, thick, long = rng.uniform(0.016, 0.023), rng.uniform(0.014, 0.019), rng.uniform(0.085, 0.115)
    power, waist = rng.uniform(2.0, 3.0), rng.uniform(0.85, 1.0)
    levels = [(-long, 1.05), (-long * 0.6, waist), (-radius, 1.0), (0.0, 1.0)]
    grip = loft([Section(z, (wide * scale, thick * scale), power) for z, scale in levels])
    foot = (rng.uniform(0.055, 0.085), rng.uniform(0.04, 0.065), rng.uniform(0.018, 0.04))
    base = box(foot).moved((rng.uniform(-0.005, 0.015), 0.0, -long - foot[2] / 2 + 0.005))
    lean = turn_about_y(rng.uniform(0.0, 0.3))
    return join(barrel, join(grip, base).moved((-length * rng.uniform(0.0, 0.25), 0.0, 0.0), lean))


def make_screwdriver(rng: np.random.Generator) -> Solid:
    """A turned handle with a thin round blade."""
    length, thick = rng.uniform(0.08, 0.11), rng.uniform(0.013, 0.019)
    waist = thick * rng.uniform(0.75, 1.0)
    radii = [thick * rng.uniform(0.8, 1.0), thick, waist, thick * rng.uniform(0.7, 0.9)]
    handle = smooth([0.0, length * 0.3, length * 0.75, length], radii)
    blade, reach = rng.uniform(0.003, 0.005), rng.uniform(0.06, 0.12)
    low = upside_down(rounded_top(radii[0], 0.0, radii[0] * 0.5))
    tip = [(blade, length), (blade, length + reach * 0.9), (blade * rng.uniform(0.3, 0.8), length + reach)]
    return turned([*low, *handle, *tip])


def make_wrench(rng: np.random.Generator) -> Solid:
    """A flat handle with an open jaw at one end, an open or closed one at the other."""
    length, thick = rng.uniform(0.10, 0.16), rng.uniform(0.016, 0.021)
    width = rng.uniform(0.013, 0.022)
    handle = strip(np.array(((-length / 2, 0.0), (length / 2, 0.0))), width, thick * rng.uniform(0.7, 1.0))
    jaws = []
    for side, closed in ((1.0, False), (-1.0, rng.random() < 0.5)):
        hole, wall = rng.uniform(0.007, 0.012), rng.uniform(0.007, 0.011)
        gap = 0.0 if closed else rng.uniform(0.5, 0.7)
        twist = rng.uniform(-0.3, 0.3)
        ring = arc(hole + wall / 2, gap + twist, 2 * math.pi - gap + twist, 14)
        head = strip(ring[:-1] if closed else ring, wall, thick, closed=closed)
        jaws.append(head.moved((length / 2 + hole, 0.0, 0.0)).moved((0, 0, 0), np.diag((side, side, 1.0))))
    return join(handle, *jaws)


def make_scissors(rng: np.random.Generator) -> Solid:
    """Two crossed blades, slightly open, with a ring each that is thicker than they are."""
    thick, opening, tall = rng.uniform(0.005, 0.007), rng.uniform(0.1, 0.3), rng.uniform(0.0205, 0.0235)
    blade, shank = rng.uniform(0.06, 0.09), rng.uniform(0.04, 0.06)
    width, hole = rng.uniform(0.012, 0.018), rng.uniform(0.011, 0.015)
    wall, out = rng.uniform(0.007, 0.010), rng.uniform(0.012, 0.022)
    path = np.array(((-shank, -out), (-shank * 0.4, -out * 0.3), (0.0, 0.0), (blade, 0.0)))
    bar = strip(path, np.array((0.6, 0.8, 1.0, 0.3)) * width, thick)
    ring = strip(arc(hole + wall / 2, 0.0, 2 * math.pi, 16)[:-1] * (1.3, 1.0), wall, tall, closed=True)
    half = join(bar, ring.moved((-shank - 1.3 * hole - wall / 4, -out - 0.3 * hole, -thick * 0.45)))
    other = half.moved((0.0, 0.0, 0.0), np.diag((1.0, -1.0, -1.0)))  # half a turn about x
    return join(
        half.moved((0.0, 0.0, thick * 0.45), turn_about_z(opening / 2)),
        other.moved((0.0, 0.0, -thick * 0.45), turn_about_z(-opening / 2)),
    )


def make_clamp(rng: np.random.Generator) -> Solid:
    """A spring clamp: two bent legs, crossed or not, about a pin."""
    tall, thick = rng.uniform(0.018, 0.032), rng.uniform(0.008, 0.014)
    jaw, leg = rng.uniform(0.03, 0.05), rng.uniform(0.05, 0.08)
    out, pin = rng.uniform(0.018, 0.03), rng.uniform(0.007, 0.011)
    path = np.array(((-leg, out), (-leg * 0.4, out * 0.75), (0.0, pin), (jaw * 0.6, pin * 1.4), (jaw, 0.006)))
    half = strip(path, thick * np.array((0.8, 1.0, 1.2, 1.0, 0.7)), tall)
    other = half.moved((0.0, 0.0, 0.0), np.diag((1.0, -1.0, -1.0)))
    middle = cylinder(pin * 1.2, tall * rng.uniform(0.8, 1.2))
    return join(half, other, middle)


def make_compound(rng: np.random.Generator) -> Solid:
    """Two to five primitives, each stuck into one before it, straight or turned at random."""
    solids = [_primitive(rng)]
    for _ in range(int(rng.integers(1, 5))):
        parent, child = solids[int(rng.integers(len(solids)))], _primitive(rng)
        straight = rng.random() < 0.5
        turn = _quarter_turns(rng) if straight else _random_turn(rng)
        child = child.moved((0.0, 0.0, 0.0), turn)
        solids.append(child.moved(_inside(parent, rng) - _inside(child, rng)))
    whole = join(*solids)
    return whole.scaled((min(1.0, _LONGEST / np.ptp(whole.vertices, axis=0).max()),) * 3)


def _primitive(rng: np.random.Generator) -> Solid:
    """A box, a cone, a rod with round ends, a ball or a prism, about the origin."""
    thick, long = rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.10)
    kind = int(rng.integers(5))
    if kind == 0:
        return box((thick, rng.uniform(0.02, 0.06), long))
    if kind == 1:
        return turned([(thick / 2, -long / 2), (thick / 2 * rng.uniform(0.4, 1.0), long / 2)])
    if kind == 2:
        top = [(thick / 2, long / 2), *rounded_top(thick / 2, long / 2, thick / 2)]
        return turned([*upside_down(top), *top])
    if kind == 3:
        cap = [(0.02, 0.0), *rounded_top(0.02, 0.0, 0.02)]
        ball = turned([*upside_down(cap)[:-1], *cap])
        return ball.scaled(rng.uniform(0.9, 1.7, 3).tolist())
    corners = arc(thick * 0.5, 0.0, 2 * math.pi, int(rng.integers(3, 7)))[:-1]
    outline = rounded(corners, 0.003)
    return prism(outline, [range(len(outline))], long, taper=rng.uniform(0.7, 1.0))


def _inside(solid: Solid, rng: np.random.Generator) -> Points:
    """(3,) a point within a convex part, towards one of its corners."""
    part = solid.parts[int(rng.integers(len(solid.parts)))]
    middle = part.mean(0)
    return middle + rng.uniform(0.3, 0.85) * (part[int(rng.integers(len(part)))] - middle)


def _quarter_turns(rng: np.random.Generator) -> Points:
    """(3, 3) one of the rotations that map the axes onto axes."""
    turn = np.eye(3)[rng.permutation(3)] * rng.choice((-1.0, 1.0), 3)
    return turn * np.linalg.det(turn)


def _random_turn(rng: np.random.Generator) -> Points:
    """(3, 3) a rotation, uniform over all of them."""
    quaternion = torch.from_numpy(rng.normal(size=4))
    return roma.unitquat_to_rotmat(quaternion / quaternion.norm()).numpy()


def turn_about_y(angle: float) -> Points:
    """(3, 3) a rotation that takes z towards x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)))


def turn_about_z(angle: float) -> Points:
    """(3, 3) a rotation that takes x towards y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


TOOLS: dict[str, Family] = {
    "drill": make_drill,
    "screwdriver": make_screwdriver,
    "wrench": make_wrench,
    "scissors": make_scissors,
    "clamp": make_clamp,
    "compound": make_compound,
}
