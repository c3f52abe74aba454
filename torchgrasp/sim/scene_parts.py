"""Parts that scenes are drawn of, and the furniture, which no depth shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER
from torchgrasp.sim.visuals import Visual, box_visual

FLOOR = -0.75
_GREY, _WOOD = (0.55, 0.57, 0.6), (0.33, 0.24, 0.16)


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh of one colour.

    Attributes:
        visual: its surface, about its own origin.
        colour: RGB in [0, 1].
        position: of furniture, metres in the base frame; the robot's parts move.
        roughness: of its material.
        specular: of its material.
    """

    visual: Visual
    colour: tuple[float, float, float]
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    roughness: float = 0.9
    specular: float = 0.1


def furniture() -> list[Part]:
    """The table's sides and legs, and the robot's pedestal."""
    half, middle = (TABLE_UPPER - TABLE_LOWER) / 2, (TABLE_UPPER + TABLE_LOWER) / 2
    # A hair below z = 0, where the top that depth knows of lies.
    parts = [Part(box_visual(half), _WOOD, tuple(middle - (0.0, 0.0, 1e-3)))]
    leg = box_visual(np.array((0.025, 0.025, (TABLE_LOWER[2] - FLOOR) / 2 - 1e-3)))
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            place = middle + (half - 0.06) * (x, y, 0.0)
            place[2] = (FLOOR + TABLE_LOWER[2]) / 2
            parts.append(Part(leg, _GREY, tuple(place), roughness=0.6))
    pedestal = box_visual(np.array((0.13, 0.13, -FLOOR / 2 - 1e-3)))
    return [*parts, Part(pedestal, _GREY, (-0.04, 0.0, FLOOR / 2), roughness=0.6)]
