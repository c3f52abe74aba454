"""Grasps of an object by geometry: antipodal contacts, covered pads, a clear hand and approach.

The paper takes its grasp sets from ACRONYM (Sec. 6.1); these come from the shape alone, so that any
mesh has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchgrasp.geometry import gripper_control_points
from torchgrasp.objects.gripper import MAX_OPENING, PAD_CENTRE, clear_of_table, hand_blocked, pad_rays
from torchgrasp.objects.solids import hull
from torchgrasp.objects.surface import RayTarget, depth_in_parts, face_normals, sample_surface, thin

Array = NDArray[np.float64]

MAX_WIDTH = 0.075
_AMPLE_ROOM = 0.03  # metres that the open fingers have to spare
MAX_TILT = 0.3  # radians between a contact's normal and the closing axis
MIN_COVERAGE = 0.3  # share of a pad that meets the object within PAD_DEPTH of its first contact
PAD_DEPTH = 0.003
APPROACH = 0.08
MIN_WIDTH = 0.0005
_CLEARANCE = 0.002  # covers what lies between two samples of the surface
_BURIED = 0.0015  # a surface point deeper than this in a part is inside the object
_APPROACHES = 10  # angles about the closing axis for each pair of contacts


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """Poses `T_object_ee` (B, 4, 4) with their quality (B,)."""

    poses: Array
    quality: Array

    def take(self, index: NDArray | slice) -> GraspCandidates:
        """The candidates of an index or mask."""
        return GraspCandidates(self.poses[index], self.quality[index])


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
    `resting` poses (K, 4, 4), half of the places go first to grasps clear of the table in those.
    """
    target = RayTarget(vertices, faces)
    dense = _clearance_points(vertices, faces, parts, rng)
    found: list[GraspCandidates] = []
    unique = (count + 1) // 2
    for _ in range(rounds):
        centres, closing = _contact_pairs(target, vertices, faces, parts, rng)
        found.append(_feasible(_hand_poses(centres, closing, rng), target, vertices, faces, dense, rng))
        if sum(len(each.poses) for each in found) >= 2 * unique:
            break
    poses = np.concatenate([each.poses for each in found])
    pool = GraspCandidates(poses, np.concatenate([each.quality for each in found]))
    at_rest = np.empty((0, 4, 4)) if resting is None else resting
    return _with_half_turns(pool.take(_spread(pool, unique, at_rest)), count)


def _clearance_points(vertices: Array, faces: NDArray, parts: Sequence, rng: np.random.Generator) -> Array:
    """Samples, about 4 mm apart, of both what is seen and what physics collides with."""
    seen, _ = sample_surface(vertices, faces, 15000, rng)
    clouds = [seen]
    for part in parts:
        corners, triangles = hull(np.asarray(part, np.float64))
        clouds.append(sample_surface(corners, triangles, 10000 // len(parts), rng)[0])
    return np.concatenate((thin(np.concatenate(clouds), 0.004), *parts))


def _contact_pairs(
    target: RayTarget, vertices: Array, faces: NDArray, parts: Sequence, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Middles (P, 3) and unit closing axes (P, 3) of antipodal pairs no wider than MAX_WIDTH."""
    normals, _ = face_normals(vertices, faces)
    first, chosen = sample_surface(vertices, faces, 2500, rng)
    outer = depth_in_parts(first, parts) < _BURIED
    first, normal = first[outer], normals[chosen[outer]]
    tilt = rng.normal(size=first.shape)
    axis = -normal + np.tan(MAX_TILT * rng.random((len(first), 1)) ** 2) * _unit(np.cross(normal, tilt))
    axis = _unit(axis)
    # The wall just touched, and the far side of all that fits between the pads: a mug's wall, or the mug.
    through, through_face = target.cast(first + 1e-5 * axis, axis)
    back, back_face = target.cast(first + (MAX_WIDTH + MIN_WIDTH) * axis, -axis)
    across = MAX_WIDTH + MIN_WIDTH - back
    across = np.where(np.abs(across - through) < 1e-4, np.inf, across)
    width, face = np.concatenate((through, across)), np.concatenate((through_face, back_face))
    first, axis = np.tile(first, (2, 1)), np.tile(axis, (2, 1))
    aligned = np.abs((normals[face] * axis).sum(1)) > np.cos(MAX_TILT)
    good = np.isfinite(width) & (width > MIN_WIDTH) & (width < MAX_WIDTH) & aligned
    good = rng.permutation(np.flatnonzero(good))[:1200]
    return first[good] + axis[good] * width[good, None] / 2, axis[good]


def _hand_poses(centres: Array, closing: Array, rng: np.random.Generator) -> Array:
    """Poses (P * approaches, 4, 4) that close along the axes, turned about them, with varied depth."""
    side = _unit(np.cross(closing, rng.normal(size=closing.shape)))
    other = np.cross(closing, side)
    angles = np.arange(_APPROACHES) * 2 * np.pi / _APPROACHES
    z = side[:, None] * np.cos(angles)[None, :, None] + other[:, None] * np.sin(angles)[None, :, None]
    y = np.broadcast_to(closing[:, None], z.shape)
    depth = PAD_CENTRE + rng.uniform(-0.008, 0.008, (*z.shape[:2], 1))
    poses = np.tile(np.eye(4), (*z.shape[:2], 1, 1))
    poses[..., :3, :3] = np.stack((np.cross(y, z), y, z), axis=-1)
    poses[..., :3, 3] = centres[:, None] - depth * z
    return poses.reshape(-1, 4, 4)


def _feasible(
    poses: Array, target: RayTarget, vertices: Array, faces: NDArray, dense: Array, rng: np.random.Generator
) -> GraspCandidates:
    """Those of the poses that hold, moved so that the object is centred, cheapest tests first."""
    coarse = dense[rng.permutation(len(dense))[:250]]
    poses = poses[~hand_blocked(coarse, poses, approach=APPROACH)]
    poses = poses[rng.permutation(len(poses))[:3000]]
    candidates = _centred(poses, target, vertices, faces)
    return candidates.take(~hand_blocked(dense, candidates.poses, approach=APPROACH, margin=_CLEARANCE))


def _centred(poses: Array, target: RayTarget, vertices: Array, faces: NDArray) -> GraspCandidates:
    """The poses whose pads meet the object squarely, moved along y until both meet it at once."""
    gap, coverage, tilt = _contacts(poses, target, vertices, faces)
    width = MAX_OPENING - gap.sum(1)
    good = (coverage > MIN_COVERAGE) & (tilt < MAX_TILT) & (width > MIN_WIDTH) & (width < MAX_WIDTH)
    moved = poses[good]
    moved[:, :3, 3] += moved[:, :3, 1] * (gap[good, 1:] - gap[good, :1]) / 2
    return GraspCandidates(moved, _quality(moved, coverage[good], tilt[good], width[good]))


def _contacts(poses: Array, target: RayTarget, vertices: Array, faces: NDArray) -> tuple[Array, Array, Array]:
    """What the open hand's pads meet: their ways (B, 2) to it, coverage (B,) and tilt (B,).

    The ways are inf where a pad meets nothing, the coverage is that of the less covered pad, the tilt
    that of the contact that is less square.
    """
    origins, directions = pad_rays(poses)
    distance, face = target.cast(origins.reshape(-1, 3), directions.reshape(-1, 3))
    distance = distance.reshape(origins.shape[:3])
    distance[distance > MAX_OPENING] = np.inf
    gap = distance.min(2)
    met = distance < gap[..., None] + PAD_DEPTH
    normals = face_normals(vertices, faces)[0][face.reshape(distance.shape)]
    facing = -(normals * directions).sum(-1, keepdims=True)
    mean = _unit((np.where(facing < 0, -normals, normals) * met[..., None]).sum(2))
    tilt = np.arccos(np.clip(-(mean * directions[:, :, 0]).sum(-1), -1, 1)).max(1)
    return gap, met.mean(2).min(1), tilt


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
    dense = _clearance_points(vertices, faces, parts, rng)
    poses = poses[~hand_blocked(dense, poses, approach=APPROACH)]
    gap, coverage, tilt = _contacts(poses, RayTarget(vertices, faces), vertices, faces)
    held = np.isfinite(gap).all(1) & (coverage > 0)
    width = MAX_OPENING - gap[held].sum(1)
    quality = _quality(poses[held], coverage[held], np.minimum(tilt[held], MAX_TILT), width)
    pool = GraspCandidates(poses[held], quality)
    return _with_half_turns(pool.take(_spread(pool, (count + 1) // 2, resting)), count)


def _quality(poses: Array, coverage: Array, tilt: Array, width: Array) -> Array:
    """[0, 1]: covered pads, square contacts, a closing point near the centre of mass, room for error."""
    centre = poses[:, :3, 3] + PAD_CENTRE * poses[:, :3, 2]
    near = np.exp(-np.linalg.norm(centre, axis=1) / 0.05)
    room = np.clip((MAX_OPENING - width) / _AMPLE_ROOM, 0.0, 1.0)
    return 0.25 * coverage + 0.2 * (1 - tilt / MAX_TILT) + 0.2 * near + 0.35 * room


def _spread(pool: GraspCandidates, count: int, resting: Array) -> NDArray[np.int64]:
    """Indices of at most `count` far-apart candidates, better ones first where equally far.

    Up to half of them are chosen for being clear of the table, in equal shares of the resting poses:
    a rod on its side leaves one grasp in twenty, and a policy has to learn those.
    """
    points = gripper_control_points().numpy().astype(np.float64)
    places = np.einsum("bij,pj->bpi", pool.poses[:, :3, :3], points) + pool.poses[:, None, :3, 3]
    places = places.reshape(len(places), 3 * len(points))
    chosen: list[int] = []
    for T_world_object in resting:
        clear = np.flatnonzero(clear_of_table(T_world_object @ pool.poses))
        _choose_far(chosen, clear, places, pool.quality, count // (2 * len(resting)))
    _choose_far(chosen, np.arange(len(places)), places, pool.quality, count - len(chosen))
    return np.asarray(chosen, np.int64)


def _choose_far(chosen: list[int], among: NDArray, places: Array, quality: Array, count: int) -> None:
    """Append to `chosen` at most `count` indices of `among`, each far from all those chosen before.

    The distance is that of the gripper's control points (Eq. 2), which weighs turns against moves.
    """
    nearest = np.full(len(among), 1.0)
    for index in chosen:
        nearest = np.minimum(nearest, ((places[among] - places[index]) ** 2).sum(1))
    for _ in range(count):
        score = nearest * (0.2 + quality[among]) ** 2
        if not len(among) or score.max() == 0.0:
            break
        chosen.append(int(among[score.argmax()]))
        nearest = np.minimum(nearest, ((places[among] - places[chosen[-1]]) ** 2).sum(1))


def _with_half_turns(grasps: GraspCandidates, count: int) -> GraspCandidates:
    """Each grasp followed by itself turned half about z, at most `count` in all."""
    poses = np.stack((grasps.poses, grasps.poses @ np.diag((-1.0, -1.0, 1.0, 1.0))), axis=1)
    return GraspCandidates(poses.reshape(-1, 4, 4), np.repeat(grasps.quality, 2)).take(slice(count))


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
