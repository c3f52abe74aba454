"""From a solid to a GraspObject: centred, weighed, with grasps and resting poses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from torchgrasp.objects.candidates import GraspCandidates
from torchgrasp.objects.grasps import sample_grasps
from torchgrasp.objects.gripper import MIN_CLEAR_GRASPS, clear_of_table
from torchgrasp.objects.model import GraspObject, content_hash
from torchgrasp.objects.resting import resting_poses
from torchgrasp.objects.solids import Solid, mass_properties

BUILD_VERSION = 5  # part of every cache file's name: raise it when the same input gives another object


def build_object(
    solid: Solid, *, name: str, family: str, licence: str, num_grasps: int, rng: np.random.Generator
) -> GraspObject:
    """A GraspObject of the solid (metres, any frame); its grasps may be few or none.

    Args:
        solid: surface and convex parts.
        name: of the object.
        family: of the object.
        licence: of its shape.
        num_grasps: upper bound on the number of grasps.
        rng: decides which grasps are found.
    """

    def find(centred: Solid, centre: np.ndarray, resting: np.ndarray) -> GraspCandidates:
        return sample_grasps(
            centred.vertices, centred.faces, centred.parts, count=num_grasps, rng=rng, resting=resting
        )

    return assemble(solid, find, name=name, family=family, licence=licence)


def assemble(
    solid: Solid,
    find_grasps: Callable[[Solid, np.ndarray, np.ndarray], GraspCandidates],
    *,
    name: str,
    family: str,
    licence: str,
) -> GraspObject:
    """A GraspObject of the solid with grasps from wherever they come.

    Args:
        solid: surface and convex parts, metres, any frame.
        find_grasps: called with the solid moved to its centre of mass, that centre (3,) in the given
            frame, and the candidates for resting poses (K, 4, 4).
        name: of the object.
        family: of the object.
        licence: of its shape.
    """
    volume, centre = mass_properties(solid.parts)
    centred = solid.moved(-centre)
    poses, probability = resting_poses(np.concatenate(centred.parts))
    grasps = find_grasps(centred, centre, poses)
    arrays = {
        "vertices": centred.vertices.astype(np.float32),
        "faces": centred.faces.astype(np.int32),
        "grasps": grasps.poses.astype(np.float32),
        "grasp_quality": grasps.quality.astype(np.float32),
        "resting_poses": poses.astype(np.float32),
        "resting_probability": probability.astype(np.float32),
        "centre_of_mass": centre.astype(np.float32),
    }
    parts = tuple(part.astype(np.float32) for part in centred.parts)
    return GraspObject(
        name=name,
        family=family,
        parts=parts,
        volume=volume,
        licence=licence,
        content_hash=content_hash((*arrays.values(), *parts)),
        **arrays,
    )


def graspable_at_rest(item: GraspObject, *, min_grasps: int = MIN_CLEAR_GRASPS) -> float:
    """The probability of the resting poses that leave at least `min_grasps` grasps clear of the table."""
    clear = [clear_of_table(pose @ item.grasps).sum() for pose in item.resting_poses]
    return float(item.resting_probability[np.asarray(clear) >= min_grasps].sum())
