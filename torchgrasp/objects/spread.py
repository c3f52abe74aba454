"""Which of many grasps an object keeps: good ones, far apart, some for each way in which it may lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchgrasp.geometry import gripper_control_points
from torchgrasp.objects.candidates import GraspCandidates
from torchgrasp.objects.contacts import Array


def choose_spread(
    pool: GraspCandidates, count: int, clear: NDArray[np.bool_], *, each: int | None = None
) -> GraspCandidates:
    """At most `count` far-apart candidates with their half turns, better ones first where equally far.

    Each is followed by its half turn about z, because the hand is symmetric. Half of the places
    go first to grasps clear of the table, as many for each resting pose: a rod on its side leaves one
    grasp in twenty, and a policy has to learn those.

    Args:
        pool: B candidates.
        count: upper bound.
        clear: (K, B) whether a candidate is clear of the table in each resting pose.
        each: grasps, without half turns, that every resting pose is given first; half of all by default.
    """
    points = gripper_control_points().numpy().astype(np.float64)
    places = np.einsum("bij,pj->bpi", pool.poses[:, :3, :3], points) + pool.poses[:, None, :3, 3]
    places = places.reshape(len(places), 3 * len(points))
    unique = (count + 1) // 2
    chosen: list[int] = []
    if each is None:
        each = unique // max(1, 2 * len(clear))
    for among in clear:
        _choose_far(chosen, np.flatnonzero(among), places, pool.quality, each)
    _choose_far(chosen, np.arange(len(places)), places, pool.quality, unique - len(chosen))
    return _with_half_turns(pool.take(np.asarray(chosen, np.int64)), count)


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
