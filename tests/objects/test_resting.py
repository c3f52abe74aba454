import numpy as np
import pytest
from scipy.spatial import ConvexHull

from torchgrasp.objects.resting import nearby_rests, resting_poses
from torchgrasp.objects.solids import box, cylinder


def test_candidates_lie_on_the_table_with_the_centre_of_mass_supported(item):
    assert 1 <= len(item.resting_poses) <= 12
    assert item.resting_probability.sum() == pytest.approx(1.0, abs=1e-5)
    assert (np.diff(item.resting_probability) <= 1e-6).all()
    points = np.concatenate(item.parts).astype(np.float64)
    for T_world_object in item.resting_poses.astype(np.float64):
        turn = T_world_object[:3, :3]
        assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-5)
        assert T_world_object[:2, 3] == pytest.approx((0.0, 0.0))
        placed = points @ turn.T + T_world_object[:3, 3]
        assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-6)
        support = ConvexHull(placed[placed[:, 2] < 0.003][:, :2])
        assert support.equations[:, 2].max() < 0  # the origin is inside


def test_a_box_rests_on_its_faces_by_their_solid_angle():
    poses, probability = resting_poses(box((0.04, 0.06, 0.06)).vertices)
    heights = poses[:, 2, 3]
    assert len(poses) == 6
    assert heights[:2] == pytest.approx((0.02, 0.02)) and heights[2:] == pytest.approx([0.03] * 4)
    assert probability.sum() == pytest.approx(1.0)
    cube = resting_poses(box((0.05, 0.05, 0.05)).vertices)[1]
    assert cube == pytest.approx([1 / 6] * 6)


def test_a_rod_lies_in_several_rolls_and_never_stands():
    poses, probability = resting_poses(cylinder(0.015, 0.3).parts[0])
    heights = poses[:, 2, 3]
    assert 4 <= len(poses) <= 12
    assert heights == pytest.approx([0.015] * len(poses), abs=1e-3)
    assert np.abs(poses[:, 2, 2]).max() < 1e-6 and probability.min() >= 0.02


def test_a_can_stands_on_either_end():
    heights = resting_poses(cylinder(0.03, 0.06).parts[0])[0][:, 2, 3]
    assert np.isclose(heights, 0.03, atol=1e-6).sum() >= 2


def test_a_top_heavy_tilted_foot_is_no_resting_pose():
    # A wedge whose centre of mass is beyond its small foot: shear moves the top over by its height.
    corners = box((0.03, 0.03, 0.09)).vertices.copy()
    corners[:, 0] += corners[:, 2]
    poses, _ = resting_poses(corners)
    assert not (np.abs(poses[:, 2, 2]) > 0.999).any()


def test_a_box_stays_on_its_face_and_a_pen_rolls():
    rng = np.random.default_rng(0)
    for solid, most in ((box((0.1, 0.06, 0.03)), 3.0), (cylinder(0.006, 0.136), 60.0)):
        points = np.concatenate(solid.parts)
        poses, _ = resting_poses(points)
        rests = nearby_rests(points, poses, 10, rng)
        assert rests.shape == (len(poses), 10, 4, 4)
        cosine = (rests[:, :, 2, :3] * poses[:, None, 2, :3]).sum(-1)
        turned = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
        assert turned.max() < most and (turned.max() > 5.0) == (most > 5.0)
        placed = np.einsum("kni,vi->knv", rests[:, :, 2, :3], points) + rests[:, :, 2, 3:]
        assert placed.min(-1) == pytest.approx(np.zeros(rests.shape[:2]), abs=1e-9)
