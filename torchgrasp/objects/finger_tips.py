"""Grasps with the tips of the fingers, for what lies so flat that the pads find no room beside it.

A pen is picked up from above: the closing axis level, the tips a few millimetres above the table, a small
part of the pads on it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchgrasp.objects.candidates import GraspCandidates, feasible
from torchgrasp.objects.contacts import Array, Body, contact_pairs, unit
from torchgrasp.objects.gripper import PAD_CENTRE, TABLE_CLEARANCE, lowest_point

# Metres of the tips above the table. Engines round hulls, so that an object settles by up to 0.4 mm.
_LOWEST = TABLE_CLEARANCE + 0.0005
_ABOVE_CONTACT = 0.002  # of the tips above the middle of two contacts, at most
_TIP_DEPTH = 0.001  # metres behind the first contact that count as met: round things curve away at once
_MIN_COVERAGE = 0.06  # share of a pad
_LEVEL = 0.35  # radians between a pair's axis and the table, before it is laid level
_LEAN = 0.15  # standard deviation, radians, of the approach from straight down
_MAX_POSES = 3000  # that rays are cast for in each round
_ENOUGH = 48  # clear grasps in each rest, after which no further round is needed
_ROUNDS = 6
_BEST = 4  # one in so many of those clear in a rest is kept: a small contact asks for square and central ones
_LEAST = 12  # that are kept of each rest


def finger_tip_grasps(body: Body, rests: Array, rng: np.random.Generator) -> GraspCandidates:
    """Grasps of the object where it lies, with the finger tips just clear of the table.

    Args:
        body: the object.
        rests: (R, 4, 4) poses on the table z = 0, R > 0.
        rng: decides which grasps are found.
    """
    found: list[GraspCandidates] = []
    clear = np.zeros((len(rests), 0), bool)
    for _ in range(_ROUNDS):
        centres, closing = contact_pairs(body, rng)
        poses = _reaching_down(centres, closing, rests, rng)
        options = {"at_most": _MAX_POSES, "depth": _TIP_DEPTH, "min_coverage": _MIN_COVERAGE}
        found.append(feasible(poses, body, rng, **options))
        clear = np.concatenate((clear, clear_in_rests(found[-1].poses, rests)), axis=1)
        if clear.sum(1).min() >= _ENOUGH:
            break
    grasps = GraspCandidates.joined(*found)
    return grasps.take(_best(grasps.quality, clear))


def _best(quality: Array, clear: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(B,) whether a grasp is among the best of those clear in one of R rests (R, B)."""
    best = np.zeros(len(quality), bool)
    for each in clear:
        among = np.flatnonzero(each)
        best[among[np.argsort(-quality[among])[: max(_LEAST, len(among) // _BEST)]]] = True
    return best


def clear_in_rests(poses: Array, rests: Array) -> NDArray[np.bool_]:
    """(R, B) whether grasps (B, 4, 4) are clear of the table in rests (R, 4, 4), with room to settle."""
    return np.stack([lowest_point(rest @ poses) > _LOWEST for rest in rests])


def steadiest(clear: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of those clear in each of R rests (R, B) the half that is clear in most of the others as well."""
    breadth = clear.sum(0)
    return np.stack([each & (breadth >= np.median(breadth[each])) if each.any() else each for each in clear])


def _reaching_down(centres: Array, closing: Array, rests: Array, rng: np.random.Generator) -> Array:
    """Poses (B, 4, 4) that close level across the pairs, from above, the tips near the table of a rest."""
    pair, rest = np.nonzero(np.abs(closing @ rests[:, 2, :3].T) < np.sin(_LEVEL))
    some = rng.permutation(len(pair))[: 2 * _MAX_POSES]
    pair, rest = pair[some], rest[some]
    up = rests[rest, 2, :3]
    y = unit(closing[pair] - (closing[pair] * up).sum(1, keepdims=True) * up)
    lean = np.clip(_LEAN * rng.normal(size=(len(y), 1)), -2 * _LEAN, 2 * _LEAN)
    z = np.sin(lean) * np.cross(y, up) - np.cos(lean) * up
    poses = np.tile(np.eye(4), (len(y), 1, 1))
    poses[:, :3, :3] = np.stack((np.cross(y, z), y, z), axis=-1)
    poses[:, :3, 3] = centres[pair] - PAD_CENTRE * z
    contact = (centres[pair] * up).sum(1) + rests[rest, 2, 3]
    room = np.maximum(contact + _ABOVE_CONTACT - _LOWEST, 1e-4)
    # Higher ones are more: they stay clear when the object rolls a little.
    height = _LOWEST + room * np.sqrt(rng.random(len(room)))
    poses[:, :3, 3] += (lowest_point(rests[rest] @ poses) - height)[:, None] / np.cos(lean) * z
    return poses
