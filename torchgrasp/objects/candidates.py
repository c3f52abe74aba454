"""Candidates for grasps: poses at which the open hand is clear and closing holds, and how good they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchgrasp.objects.contacts import MAX_TILT, MAX_WIDTH, MIN_WIDTH, PAD_DEPTH, Array, Body, pad_contacts
from torchgrasp.objects.gripper import MAX_OPENING, PAD_CENTRE, hand_blocked

APPROACH = 0.08  # metres of straight way to the grasp that must be clear
MIN_COVERAGE = 0.3  # share of a pad that meets the object
_AMPLE_ROOM = 0.03  # metres that the open fingers have to spare
_CLEARANCE = 0.002  # covers what lies between two samples of the surface


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """Poses `T_object_ee` (B, 4, 4) with their quality (B,)."""

    poses: Array
    quality: Array

    @classmethod
    def joined(cls, *groups: GraspCandidates) -> GraspCandidates:
        """The candidates of several groups, in their order."""
        poses, quality = ([getattr(each, name) for each in groups] for name in ("poses", "quality"))
        return cls(np.concatenate(poses), np.concatenate(quality))

    def take(self, index: NDArray | slice) -> GraspCandidates:
        """The candidates of an index or mask."""
        return GraspCandidates(self.poses[index], self.quality[index])


def feasible(
    poses: Array,
    body: Body,
    rng: np.random.Generator,
    *,
    at_most: int,
    depth: float = PAD_DEPTH,
    min_coverage: float = MIN_COVERAGE,
) -> GraspCandidates:
    """Those of the poses that hold, moved so that the object is centred, cheapest tests first.

    Args:
        poses: (B, 4, 4) `T_object_ee`.
        body: the object.
        rng: decides which are looked at.
        at_most: poses that rays are cast for.
        depth: metres behind the first contact that a pad still meets.
        min_coverage: share of a pad that must meet the object.
    """
    coarse = body.dense[rng.permutation(len(body.dense))[:250]]
    poses = poses[~hand_blocked(coarse, poses, approach=APPROACH)]
    poses = poses[rng.permutation(len(poses))[:at_most]]
    candidates = _centred(poses, body, depth, min_coverage)
    return candidates.take(~hand_blocked(body.dense, candidates.poses, approach=APPROACH, margin=_CLEARANCE))


def _centred(poses: Array, body: Body, depth: float, min_coverage: float) -> GraspCandidates:
    """The poses whose pads meet the object squarely, moved along y until both meet it at once."""
    gap, coverage, tilt = pad_contacts(poses, body, depth=depth)
    width = MAX_OPENING - gap.sum(1)
    good = (coverage > min_coverage) & (tilt < MAX_TILT) & (width > MIN_WIDTH) & (width < MAX_WIDTH)
    moved = poses[good]
    moved[:, :3, 3] += moved[:, :3, 1] * (gap[good, 1:] - gap[good, :1]) / 2
    return GraspCandidates(moved, grasp_quality(moved, coverage[good], tilt[good], width[good]))


def grasp_quality(poses: Array, coverage: Array, tilt: Array, width: Array) -> Array:
    """[0, 1]: covered pads, square contacts, a closing point near the centre of mass, room for error."""
    centre = poses[:, :3, 3] + PAD_CENTRE * poses[:, :3, 2]
    near = np.exp(-np.linalg.norm(centre, axis=1) / 0.05)
    room = np.clip((MAX_OPENING - width) / _AMPLE_ROOM, 0.0, 1.0)
    return 0.25 * coverage + 0.2 * (1 - tilt / MAX_TILT) + 0.2 * near + 0.35 * room
