"""Flat things: outlines made of convex cells, drawn out to a height and tapered."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from torchgrasp.objects.solids import Points, Solid

Cells = Sequence[Sequence[int]]


def prism(points: Points, cells: Cells, height: float, *, taper: float = 1.0) -> Solid:
    """An outline between z = -height / 2 and height / 2: one convex part for each cell.

    Args:
        points: (N, 2) corners, metres.
        cells: convex polygons, counter-clockwise, that fill the outline; neighbours share whole edges.
        height: metres.
        taper: scale of the upper face about the origin.
    """
    count = len(points)
    low = np.column_stack((points, np.full(count, -height / 2)))
    high = np.column_stack((points * taper, np.full(count, height / 2)))
    edges = {(a, b) for cell in cells for a, b in zip(cell, [*cell[1:], cell[0]], strict=True)}
    faces = []
    for cell in cells:
        fan = np.array([(cell[0], b, c) for b, c in pairwise(cell[1:])])
        faces += [fan[:, ::-1], fan + count]
    rim = sorted((a, b) for a, b in edges if (b, a) not in edges)
    faces += [np.array([(a, b, b + count), (a, b + count, a + count)]) for a, b in rim]
    parts = tuple(np.concatenate((low[list(cell)], high[list(cell)])) for cell in cells)
    return Solid(np.concatenate((low, high)), np.concatenate(faces), parts)


def strip(
    path: Points, widths: Points | float, height: float, *, closed: bool = False, taper: float = 1.0
) -> Solid:
    """A flat bar of a height along a path (N, 2), mitred at its corners; a ring where it is closed.

    Args:
        path: (N, 2) the middle line, metres.
        widths: across it, one or (N,).
        height: metres.
        closed: whether the last point is joined to the first.
        taper: scale of the upper face about the origin.
    """
    ahead = np.roll(path, -1, axis=0) - path
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    behind = np.roll(ahead, 1, axis=0)
    if not closed:
        ahead[-1], behind[0] = behind[-1], ahead[0]
    mean = ahead + behind
    # Of a mitre that is as wide as the bar on both sides: twice the half width over 1 + cos(turn).
    across = np.stack((-mean[:, 1], mean[:, 0]), axis=1) / (1 + (ahead * behind).sum(1))[:, None]
    offset = across * (np.broadcast_to(widths, len(path))[:, None] / 2)
    count = len(path)
    points = np.concatenate((path - offset, path + offset))
    steps = [(i, (i + 1) % count) for i in range(count if closed else count - 1)]
    return prism(points, [(i, j, j + count, i + count) for i, j in steps], height, taper=taper)


def star(
    angles: Points, radius: float, lengths: Sequence[float], tips: float, height: float, *, taper: float = 1.0
) -> Solid:
    """Arms about a middle: stars, crosses and, where a length is zero, letters such as T.

    Args:
        angles: (K,) directions of K > 2 arms, rising, less than half a turn apart.
        radius: of the middle's corners, which lie halfway between two arms.
        lengths: of the arms from the middle, zero for none.
        tips: their width at the end, as a share of that at the middle.
        height: metres.
        taper: scale of the upper face about the origin.
    """
    following = np.roll(angles, -1) + np.where(np.arange(len(angles)) == len(angles) - 1, 2 * np.pi, 0.0)
    between = (angles + following) / 2
    corners = radius * np.stack((np.cos(between), np.sin(between)), axis=1)
    points, cells = [*corners], [tuple(range(len(corners)))]
    for i, (angle, length) in enumerate(zip(angles, lengths, strict=True)):
        if length > 0:
            right, left = corners[i - 1], corners[i]
            tip = np.array((np.cos(angle), np.sin(angle))) * length + (right + left) / 2
            cells.append((i, (i - 1) % len(corners), len(points), len(points) + 1))
            points += [tip + (right - left) / 2 * tips, tip + (left - right) / 2 * tips]
    return prism(np.array(points), cells, height, taper=taper)


def rounded(corners: Points, radius: float, *, steps: int = 3) -> Points:
    """(N * (steps + 1), 2) outline of a convex polygon (N, 2), counter-clockwise, grown by a radius."""
    ahead = np.roll(corners, -1, axis=0) - corners
    heading = np.arctan2(ahead[:, 1], ahead[:, 0]) - np.pi / 2
    before = np.roll(heading, 1)
    turn = np.mod(heading - before, 2 * np.pi)
    angles = before[:, None] + turn[:, None] * np.linspace(0.0, 1.0, steps + 1)
    arcs = corners[:, None] + radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    return arcs.reshape(-1, 2)
