import numpy as np
import pytest

from torchgrasp.objects.contacts import Body
from torchgrasp.objects.finger_tips import clear_in_rests, finger_tip_grasps
from torchgrasp.objects.grasps import sample_grasps
from torchgrasp.objects.gripper import (
    MIN_CLEAR_GRASPS,
    PAD_CENTRE,
    PAD_HALF,
    TABLE_CLEARANCE,
    hand_blocked,
    lowest_point,
)
from torchgrasp.objects.resting import nearby_rests, resting_poses
from torchgrasp.objects.solids import Solid, box, cylinder

TIP = PAD_CENTRE + PAD_HALF[1]
THIN = {
    "pen": cylinder(0.006, 0.136),
    "bar": box((0.15, 0.009, 0.009)),
}


def at_rest(solid: Solid):
    return resting_poses(np.concatenate(solid.parts))[0]


def tips_of(solid: Solid):
    """The body, its rests and the grasps with the finger tips that it has there."""
    body = Body.of(solid.vertices, solid.faces, solid.parts, np.random.default_rng(0))
    rests = at_rest(solid)
    return body, rests, finger_tip_grasps(body, rests, np.random.default_rng(1)).poses


@pytest.mark.parametrize("name", THIN)
def test_what_lies_flat_is_taken_however_it_settles(name):
    solid, rng = THIN[name], np.random.default_rng(0)
    resting = at_rest(solid)
    found = sample_grasps(solid.vertices, solid.faces, solid.parts, count=400, rng=rng, resting=resting)
    assert len(found.poses) == 400
    rests = nearby_rests(np.concatenate(solid.parts), resting[:3], 20, rng).reshape(-1, 4, 4)
    clear = np.array([(lowest_point(rest @ found.poses) > TABLE_CLEARANCE).sum() for rest in rests])
    assert (clear >= MIN_CLEAR_GRASPS).mean() > 0.6


def test_tips_come_from_above_and_stay_clear():
    body, rests, poses = tips_of(THIN["bar"])
    assert len(poses) > 100
    clear = clear_in_rests(poses, rests)
    assert clear.any(0).all()
    tilt = np.einsum("ri,bi->rb", rests[:, 2, :3], poses[:, :3, 2])
    closing = np.einsum("ri,bi->rb", rests[:, 2, :3], poses[:, :3, 1])
    assert (np.where(clear, tilt, np.inf).min(0) < -0.8).all()
    assert (np.where(clear, np.abs(closing), np.inf).min(0) < 1e-9).all()
    assert not hand_blocked(body.dense, poses).any()


def test_the_pads_close_on_the_axis_of_a_pen():
    _, _, poses = tips_of(THIN["pen"])
    ends = np.array(((0.0, 0.0, -0.06), (0.0, 0.0, 0.06)))
    for pose in poses[:: max(1, len(poses) // 50)]:
        local = (ends - pose[:3, 3]) @ pose[:3, :3]
        along = local[0] + (local[1] - local[0]) * (local[0, 0] / (local[0, 0] - local[1, 0]))
        assert abs(along[1]) < 1e-3  # between the fingers
        assert TIP - 2 * PAD_HALF[1] < along[2] < TIP + 0.004


def test_what_is_too_wide_gets_none():
    assert len(tips_of(box((0.1, 0.1, 0.008)))[2]) == 0
