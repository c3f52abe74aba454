"""Back-projection, sampling, the gripper's points."""

import math

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, gripper_control_points, invert_pose, transform_points
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AppendGripperPoints, DepthToPoints, SamplePoints


def picture(depth: torch.Tensor, mask: torch.Tensor, T_base_ee=None, T_base_camera=None) -> TensorDict:
    shape = depth.shape[:-2]
    eye = torch.eye(4).expand(*shape, 4, 4)
    poses = {
        "T_base_ee": eye if T_base_ee is None else T_base_ee,
        "T_base_camera": eye if T_base_camera is None else T_base_camera,
    }
    return TensorDict({"camera": {"depth": depth, "mask": mask}, **poses}, shape)


def test_a_pixel_goes_to_the_point_it_shows():
    # 4 x 2 pixels, 90 degrees: focal length 1 pixel; pixel (row 0, column 3) looks along (1.5, -0.5, 1).
    depth = torch.full((2, 4), 2.0)
    mask = torch.zeros(2, 4, dtype=torch.bool)
    mask[0, 3] = mask[1, 0] = True
    out = DepthToPoints(fov=math.pi / 2)(picture(depth, mask))
    assert out["num_points"].tolist() == [2] and out["points"].shape == (8, 3)
    assert torch.allclose(out["points"][:2], torch.tensor([[3.0, -1.0, 2.0], [-3.0, 1.0, 2.0]]))
    assert not out["points"][2:].any()


def test_points_are_in_the_hand_frame_wherever_hand_and_camera_are():
    torch.manual_seed(0)
    depth, mask = torch.rand(5, 6, 6) + 0.1, torch.rand(5, 6, 6) > 0.5
    T_base_ee, T_base_camera = action_to_pose(torch.rand(5, 6)), action_to_pose(torch.rand(5, 6))
    out = DepthToPoints()(picture(depth, mask, T_base_ee, T_base_camera))
    in_camera = DepthToPoints()(picture(depth, mask))
    expected = transform_points(invert_pose(T_base_ee) @ T_base_camera, in_camera["points"])
    for row, n in enumerate(out["num_points"].flatten().tolist()):
        assert n == int(mask[row].sum())
        assert torch.allclose(out["points"][row, :n], expected[row, :n], atol=1e-5)


def test_pixels_without_a_return_are_no_points():
    depth = torch.tensor([[0.0, 1.0], [1.0, 0.0]])
    out = DepthToPoints()(picture(depth, torch.ones(2, 2, dtype=torch.bool)))
    assert out["num_points"].item() == 2
    nothing = DepthToPoints()(picture(depth, torch.zeros(2, 2, dtype=torch.bool)))
    assert nothing["num_points"].item() == 0 and not nothing["points"].any()


def test_pictures_of_other_shapes_get_rays_of_their_own():
    transform = DepthToPoints()
    for height, width in ((4, 4), (2, 8), (8, 2)):
        depth, mask = torch.ones(height, width), torch.ones(height, width, dtype=torch.bool)
        out, fresh = (t(picture(depth, mask)) for t in (transform, DepthToPoints()))
        assert torch.equal(out["points"], fresh["points"])


def test_points_of_a_simulated_picture_lie_on_the_object():
    torch.set_num_threads(1)
    objects = ProceduralObjects("train", num_objects=1, num_grasps=100)  # a box
    camera = RaycastCamera(CameraIntrinsics(48, 32, fov=1.2))
    state = DepthToPoints(fov=1.2)(GraspEnv(4, objects=objects, camera=camera, seed=0).reset())
    half = torch.from_numpy(objects[0].size) / 2
    for world in state:
        cloud = world["points"][: int(world["num_points"])]
        assert len(cloud) > 5
        local = transform_points(torch.linalg.solve(world["T_base_object"], world["T_base_ee"]), cloud)
        assert torch.all(local.abs() < half + 2e-4)
        assert ((local.abs() - half).abs().amin(-1) < 2e-4).all()  # on one of its faces


def clouds(counts: list[int], width: int = 50) -> TensorDict:
    """Clouds whose point i of row b is (b, i, 1), zeros behind."""
    n = torch.tensor(counts)[:, None]
    b, i = torch.meshgrid(torch.arange(len(counts)), torch.arange(width), indexing="ij")
    points = torch.stack((b, i, torch.ones_like(i)), dim=-1) * (i < n)[..., None]
    return TensorDict({"points": points.float(), "num_points": n}, [len(counts)])


def test_enough_points_are_drawn_without_repetition():
    out = SamplePoints(16)(clouds([50, 16]))
    assert out["points"].shape == (2, 16, 3) and out["num_points"].flatten().tolist() == [16, 16]
    for row in range(2):
        assert len(set(out["points"][row, :, 1].tolist())) == 16
        assert torch.all(out["points"][row, :, 0] == row)


def test_too_few_points_are_all_taken_and_drawn_again():
    out = SamplePoints(16)(clouds([7]))
    assert out["num_points"].item() == 7
    assert sorted(out["points"][0, :7, 1].tolist()) == list(range(7))
    assert torch.all(out["points"][0, :, 2] == 1.0)  # none from behind the cloud


def test_no_points_become_zeros():
    out = SamplePoints(16)(clouds([0, 3]))
    assert not out["points"][0].any() and out["num_points"].flatten().tolist() == [0, 3]


def test_every_point_is_as_likely_as_another():
    sampler = SamplePoints(10)
    seen = torch.cat([sampler(clouds([50]))["points"][0, :, 1] for _ in range(500)])
    frequency = torch.bincount(seen.long(), minlength=50) / 500
    assert frequency.mean() == pytest.approx(0.2) and (frequency - 0.2).abs().max() < 0.08


def test_gripper_points_are_marked_at_the_end():
    out = AppendGripperPoints()(clouds([5, 5]))
    assert out["points"].shape == (2, 56, 4)
    assert torch.equal(out["points"][..., 3], (torch.arange(56) >= 50).float().expand(2, 56))
    assert torch.equal(out["points"][1, 50:, :3], gripper_control_points())
    assert torch.equal(out["points"][:, :50, :3], clouds([5, 5])["points"])


@pytest.mark.parametrize(
    "make", [lambda: SamplePoints(0), lambda: SamplePoints(-5), lambda: DepthToPoints(fov=0.0)]
)
def test_impossible_numbers_are_refused(make):
    with pytest.raises(ConfigError, match=r"^(num_points|fov)="):
        make()
