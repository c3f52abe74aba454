import pytest
import roma
import torch

from torchgrasp import geometry as geo

torch.set_num_threads(1)
F64 = torch.float64


@pytest.fixture
def poses() -> torch.Tensor:
    g = torch.Generator().manual_seed(0)
    goals = torch.randn(64, 7, generator=g, dtype=F64)
    return geo.goal_to_pose(goals)


def test_poses_are_rigid(poses):
    rotation = poses[:, :3, :3]
    assert torch.allclose(rotation @ rotation.mT, torch.eye(3, dtype=F64).expand(64, 3, 3), atol=1e-12)
    assert torch.allclose(torch.linalg.det(rotation), torch.ones(64, dtype=F64), atol=1e-12)
    assert torch.equal(poses[:, 3], torch.tensor([0, 0, 0, 1.0], dtype=F64).expand(64, 4))


def test_inverse_undoes_a_pose_from_both_sides(poses):
    eye = torch.eye(4, dtype=F64).expand(64, 4, 4)
    assert torch.allclose(geo.invert_pose(poses) @ poses, eye, atol=1e-12)
    assert torch.allclose(poses @ geo.invert_pose(poses), eye, atol=1e-12)


def test_points_move_as_homogeneous_coordinates(poses):
    points = torch.randn(64, 5, 3, dtype=F64)
    ones = torch.ones(64, 5, 1, dtype=F64)
    expected = (poses @ torch.cat((points, ones), -1).mT).mT[..., :3]
    assert torch.allclose(geo.transform_points(poses, points), expected, atol=1e-12)


def test_actions_and_poses_convert_both_ways():
    action = torch.empty(200, 6, dtype=F64).uniform_(-1.5, 1.5)
    assert torch.allclose(geo.pose_to_action(geo.action_to_pose(action)), action, atol=1e-9)


def test_euler_angles_are_intrinsic_xyz():
    a, b, c = 0.3, -0.4, 0.5
    axes = torch.eye(3, dtype=F64)
    turns = [roma.rotvec_to_rotmat(axes[i] * angle) for i, angle in enumerate((a, b, c))]
    action = torch.tensor([0, 0, 0, a, b, c], dtype=F64)
    assert torch.allclose(geo.action_to_pose(action)[:3, :3], turns[0] @ turns[1] @ turns[2], atol=1e-12)


def test_goals_and_poses_convert_both_ways_with_w_positive(poses):
    goal = geo.pose_to_goal(poses)
    assert (goal[:, 6] >= 0).all()
    assert torch.allclose(goal[:, 3:].norm(dim=-1), torch.ones(64, dtype=F64), atol=1e-12)
    assert torch.allclose(geo.goal_to_pose(goal), poses, atol=1e-12)


def test_a_goal_names_the_same_pose_at_any_length_and_sign_of_its_quaternion():
    goal = torch.tensor([0.1, 0.2, 0.3, 0.5, -0.5, 0.1, 0.7])
    scaled = torch.cat((goal[:3], -3.0 * goal[3:]))
    assert torch.allclose(geo.goal_to_pose(goal), geo.goal_to_pose(scaled), atol=1e-6)


def test_a_network_that_starts_at_zero_gets_finite_poses_and_gradients():
    goal = torch.zeros(3, 7, requires_grad=True)
    pose = geo.goal_to_pose(goal)
    pose.sum().backward()
    assert torch.isfinite(pose).all() and torch.isfinite(goal.grad).all()


def test_quaternions_turn_as_romas_do_and_those_of_no_length_turn_nothing():
    quaternions = torch.randn(64, 4, dtype=F64, generator=torch.Generator().manual_seed(1))
    expected = roma.unitquat_to_rotmat(quaternions / quaternions.norm(dim=-1, keepdim=True))
    assert torch.allclose(geo.quaternion_to_rotation(quaternions), expected, atol=1e-12)
    assert torch.equal(geo.quaternion_to_rotation(torch.zeros(4)), torch.eye(3))


@pytest.mark.parametrize("roll", [0.0, 1.0, -2.5])
def test_look_along_is_a_rotation_whose_z_axis_is_the_direction(roll):
    direction = torch.cat((torch.randn(20, 3, dtype=F64), torch.tensor([[0, 0, 2.0], [0, 0, -1.0]]).double()))
    frame = geo.look_along(direction, torch.full((22,), roll, dtype=F64))
    expected = direction / direction.norm(dim=-1, keepdim=True)
    assert torch.allclose(frame[..., 2], expected, atol=1e-12)
    assert torch.allclose(torch.linalg.det(frame), torch.ones(22, dtype=F64), atol=1e-12)


def test_look_along_without_roll_holds_x_upwards():
    frame = geo.look_along(torch.tensor([[1.0, 0.0, 0.0], [0.6, 0.0, -0.8]]), torch.zeros(2))
    expected = torch.tensor([[0.0, 0.0, 1.0], [0.8, 0.0, 0.6]])
    assert torch.allclose(frame[..., 0], expected, atol=1e-6)


def test_control_points_are_those_of_the_released_code():
    points = geo.gripper_control_points()
    assert points.shape == (6, 3) and torch.equal(points[0], points[1])
    assert torch.allclose(points[2:, 1].abs(), torch.full((4,), 0.053))
    assert points[:, 2].tolist() == pytest.approx([0, 0, 0.075, 0.075, 0.105, 0.105])


def test_every_batch_shape_is_welcome():
    action = torch.randn(2, 3, 6) * 0.1
    pose = geo.action_to_pose(action)
    assert pose.shape == (2, 3, 4, 4)
    assert geo.pose_to_action(pose).shape == (2, 3, 6)
    assert geo.pose_to_goal(pose[0, 0]).shape == (7,)
    assert geo.invert_pose(pose).shape == pose.shape
    assert geo.transform_points(pose, torch.zeros(2, 3, 5, 3)).shape == (2, 3, 5, 3)
