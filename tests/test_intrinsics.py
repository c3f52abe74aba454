"""Pinhole cameras: by a field of view, by calibration, thinned out."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from torchgrasp.errors import ConfigError
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.transforms import AggregatePoints, DepthToPoints

REALSENSE = CameraIntrinsics(848, 480, fx=612.3, fy=611.9, cx=421.4, cy=243.7)


def project(camera, points):
    """OpenCV's projection: the centre of the first pixel is at (0, 0)."""
    k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    seen = points @ k.T
    return seen[:, :2] / seen[:, 2:]


def test_rays_go_through_the_pixels_that_opencv_projects_to():
    pixels = project(REALSENSE, REALSENSE.rays.astype(np.float64))
    grid = np.stack(np.meshgrid(np.arange(848), np.arange(480)), axis=-1).reshape(-1, 2)
    assert np.abs(pixels - grid).max() < 1e-3


def test_a_field_of_view_is_a_focal_length_and_the_middle():
    by_view = CameraIntrinsics(64, 48, fov=1.2)
    focal = 24 / np.tan(0.6)
    by_focal = CameraIntrinsics(64, 48, fx=focal, cx=31.5, cy=23.5)
    assert np.array_equal(by_view.rays, by_focal.rays)
    assert by_view.centre.tolist() == [32.0, 24.0]


@pytest.mark.parametrize("step", [1, 3, 5])
def test_a_thinned_picture_is_seen_as_the_whole_one(step):
    thin = REALSENSE.thin_out(step)
    rays = REALSENSE.rays.reshape(480, 848, 3)[::step, ::step]
    assert (thin.height, thin.width) == rays.shape[:2]
    assert np.abs(thin.rays.reshape(rays.shape) - rays).max() < 1e-6


def test_a_matrix_of_opencv_is_taken_as_it_is():
    k = [[612.3, 0.0, 421.4], [0.0, 611.9, 243.7], [0.0, 0.0, 1.0]]
    assert CameraIntrinsics.from_matrix(k, width=848, height=480) == REALSENSE
    flat = np.ravel(k).tolist()  # as ROS has it
    assert CameraIntrinsics.from_matrix(flat, width=848, height=480) == REALSENSE
    for wrong in (np.eye(4), [[612.3, 2.0, 421.4], [0, 611.9, 243.7], [0, 0, 1]], np.zeros((3, 3))):
        with pytest.raises(ConfigError):
            CameraIntrinsics.from_matrix(wrong, width=848, height=480)


@pytest.mark.parametrize(
    "options", [{"fy": 600.0}, {"fx": 0.0}, {"fx": float("nan")}, {"cx": 848.0}, {"cy": -3.0}]
)
def test_impossible_calibrations_are_refused(options):
    with pytest.raises(ConfigError):
        CameraIntrinsics(848, 480, **options)


def test_clouds_and_carving_see_through_a_calibrated_camera():
    """A wall at 0.5 m seen off-centre; points before it go, and one stands for them; those beside it stay."""
    camera = CameraIntrinsics(40, 30, fx=50.0, fy=40.0, cx=12.0, cy=20.0)
    depth = torch.full((2, 30, 40), 0.5)
    mask = torch.zeros(2, 30, 40, dtype=torch.bool)
    mask[0, 10:12, 5:7] = True
    depth[0][mask[0]] = 0.3
    pose = torch.eye(4).expand(2, 4, 4)
    views = TensorDict(
        {"camera": {"depth": depth, "mask": mask}, "T_base_ee": pose, "T_base_camera": pose}, [2]
    )
    seen = DepthToPoints(intrinsics=camera)(views)
    assert seen["num_points"].flatten().tolist() == [4, 0]
    assert torch.allclose(seen["points"][0, 0], torch.tensor([(5 - 12) / 50, (10 - 20) / 40, 1.0]) * 0.3)
    joined = AggregatePoints(1.0, carve=0.01, intrinsics=camera)(seen.clone())
    assert joined["num_points"].flatten().tolist() == [4, 1]
    assert torch.allclose(joined["points"][1, 0], seen["points"][0, :4].mean(dim=0))
    off = CameraIntrinsics(40, 30, fx=50.0, cx=-0.4, cy=-0.4)  # they would lie left of the picture
    kept = AggregatePoints(1.0, carve=0.01, intrinsics=off)(seen.clone())
    assert kept["num_points"].flatten().tolist() == [4, 4]


def test_a_picture_of_another_size_than_calibrated_is_refused():
    with pytest.raises(ConfigError, match="48 x 32 pixels does not belong to intrinsics of 40 x 30"):
        DepthToPoints(intrinsics=CameraIntrinsics(40, 30))(
            TensorDict(
                {
                    "camera": {"depth": torch.ones(32, 48), "mask": torch.ones(32, 48).bool()},
                    "T_base_ee": torch.eye(4),
                    "T_base_camera": torch.eye(4),
                }
            )
        )
    with pytest.raises(ConfigError, match="give one of them"):
        AggregatePoints(fov=1.0, intrinsics=CameraIntrinsics())
