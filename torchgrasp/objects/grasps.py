"""Grasps of an object by geometry: antipodal contacts, covered pads, a clear hand and approach.

The paper takes its grasp sets from ACRONYM (Sec. 6.1); these come from the shape alone, so that any
mesh has them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from torchgrasp.objects.candidates import APPROACH, GraspCandidates, feasible, grasp_quality
from torchgrasp.objects.contacts import MAX_TILT, Array, Body, contact_pairs, pad_contacts, unit
from torchgrasp.objects.finger_tips import clear_in_rests, finger_tip_grasps, steadiest
from torchgrasp.objects.gripper import (
    MAX_OPENING,
    MIN_CLEAR_GRASPS,
    PAD_CENTRE,
    TABLE_CLEARANCE,
    clear_of_table,
    hand_blocked,
    lowest_point,
)
from torchgrasp.objects.resting import nearby_rests
from torchgrasp.objects.spread import choose_spread

_APPROACHES = 10  # angles about the closing axis for each pair of contacts
_MAX_POSES = 3000  # that rays are cast for in each round
# About each resting pose: in most of the former an object leaves grasps clear or lies too flat; in the
# latter it gets grasps with the finger tips. Of a pen, three of its eight poses are served: all look alike.
_RESTS_TO_JUDGE, _RESTS_TO_SERVE, _LAYS = 14, 40, 3
_USUAL = 400  # grasps by which an object is judged: fewer leave too few clear of a rod as well


def sample_grasps(
    vertices: Array,
    faces: NDArray,
    parts: Sequence[np.ndarray],
    *,
    count: int,
    rng: np.random.Generator,
    resting: Array | None = None,
    rounds: int = 6,
) -> GraspCandidates:
    """At most `count` diverse grasps of an object whose centre of mass is the origin.

    Every grasp comes with its half turn about z (the hand is symmetric), next to it in the order.
    Fewer come back where the shape offers fewer in `rounds` tries; none for what does not fit. With
    `resting` poses (K, 4, 4), half of the places go first to grasps clear of the table in those. What
    lies too flat in all of them gets grasps with the finger tips, for up to three quarters of the places.
    """
    body = Body.of(vertices, faces, parts, rng)
    pool = _whole_pad_grasps(body, enough=count + count % 2, rng=rng, rounds=rounds)
    if resting is None:
        return choose_spread(pool, count, np.empty((0, len(pool.poses)), bool))
    clear = np.stack([clear_of_table(pose @ pool.poses) for pose in resting])
    grasps = choose_spread(pool, count, clear)
    corners = np.concatenate(parts)
    usual = grasps if count >= _USUAL else choose_spread(pool, _USUAL, clear)
    if _too_flat(usual, nearby_rests(corners, resting, _RESTS_TO_JUDGE, rng)):
        rests = nearby_rests(corners, resting[:_LAYS], _RESTS_TO_SERVE, rng).reshape(-1, 4, 4)
        pool = GraspCandidates.joined(pool, finger_tip_grasps(body, rests, rng))
        most = max(1, 3 * count // 8)  # three quarters of the places
        served = np.unique(np.linspace(0, len(rests) - 1, most).astype(int))  # all, where there are places
        clear = steadiest(clear_in_rests(pool.poses, rests))[served]
        grasps = choose_spread(pool, count, clear, each=most // len(clear))
    return grasps


def _whole_pad_grasps(body: Body, *, enough: int, rng: np.random.Generator, rounds: int) -> GraspCandidates:
    """Grasps from all sides, at least `enough` where that many are found in the rounds."""
    found: list[GraspCandidates] = []
    for _ in range(rounds):
        centres, closing = contact_pairs(body, rng)
        found.append(feasible(_hand_poses(centres, closing, rng), body, rng, at_most=_MAX_POSES))
        if sum(len(each.poses) for each in found) >= enough:
            break
    return GraspCandidates.joined(*found)


def _too_flat(grasps: GraspCandidates, rests: Array) -> bool:
    """Whether no resting pose, in most of the rests (K, R, 4, 4) about it, leaves grasps enough clear."""
    heights = [[lowest_point(rest @ grasps.poses) for rest in about] for about in rests]
    clear = (np.array(heights) > TABLE_CLEARANCE).sum(-1)
    return bool((np.median(clear, axis=1) < MIN_CLEAR_GRASPS).all())


def _hand_poses(centres: Array, closing: Array, rng: np.random.Generator) -> Array:
    """Poses (P * approaches, 4, 4) that close along the axes, turned about them, with varied depth."""
    side = unit(np.cross(closing, rng.normal(size=closing.shape)))
    other = np.cross(closing, side)
    angles = np.arange(_APPROACHES) * 2 * np.pi / _APPROACHES
    z = side[:, None] * np.cos(angles)[None, :, None] + other[:, None] * np.sin(angles)[None, :, None]
    y = np.broadcast_to(closing[:, None], z.shape)
    depth = PAD_CENTRE + rng.uniform(-0.008, 0.008, (*z.shape[:2], 1))
    poses = np.tile(np.eye(4), (*z.shape[:2], 1, 1))
    poses[..., :3, :3] = np.stack((np.cross(y, z), y, z), axis=-1)
    poses[..., :3, 3] = centres[:, None] - depth * z
    return poses.reshape(-1, 4, 4)


def choose_grasps(
    poses: Array,
    vertices: Array,
    faces: NDArray,
    parts: Sequence[np.ndarray],
    *,
    count: int,
    rng: np.random.Generator,
    resting: Array,
) -> GraspCandidates:
    """At most `count` of grasps found elsewhere, with their half turns, far apart, as `sample_grasps` does.

    Left out are those at which the open hand, or its straight approach, meets the object, and those
    whose pads do not both meet it. The grasps are not moved.

    Args:
        poses: (B, 4, 4) `T_object_ee`, the object's centre of mass at the origin.
        vertices: (V, 3) metres.
        faces: (F, 3) indices.
        parts: the convex parts.
        count: upper bound.
        rng: decides which points of the surface are tested.
        resting: (K, 4, 4) poses in whose favour half of the places go.
    """
    body = Body.of(vertices, faces, parts, rng)
    poses = poses[~hand_blocked(body.dense, poses, approach=APPROACH)]
    gap, coverage, tilt = pad_contacts(poses, body)
    held = np.isfinite(gap).all(1) & (coverage > 0)
    width = MAX_OPENING - gap[held].sum(1)
    quality = grasp_quality(poses[held], coverage[held], np.minimum(tilt[held], MAX_TILT), width)
    pool = GraspCandidates(poses[held], quality)
    return choose_spread(pool, count, np.stack([clear_of_table(pose @ pool.poses) for pose in resting]))
