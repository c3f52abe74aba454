"""The table's plane in the hand's frame, and what mirrors and networks make of it."""

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.geometry import invert_pose, transform_points
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic, PointNet, ResNet18
from torchgrasp.transforms import RandomMirror, TablePlane


def make_poses(n: int) -> torch.Tensor:
    torch.manual_seed(0)
    rotation = torch.linalg.qr(torch.randn(n, 3, 3)).Q
    rotation = rotation * torch.linalg.det(rotation)[:, None, None]
    poses = torch.eye(4).repeat(n, 1, 1)
    poses[:, :3, :3], poses[:, :3, 3] = rotation, torch.randn(n, 3)
    return poses


def make_batch(n: int = 8) -> TensorDict:
    poses = make_poses(n)
    in_base = torch.randn(n, 20, 3)
    cloud = torch.cat((transform_points(invert_pose(poses), in_base), torch.zeros(n, 20, 1)), dim=-1)
    batch = TensorDict({"T_base_ee": poses, "points": cloud, "time_left": torch.rand(n, 1)}, [n])
    return TablePlane()(batch).set("in_base", in_base).set("action", 0.01 * torch.randn(n, 6))


def heights(batch: TensorDict) -> torch.Tensor:
    plane = batch["table_plane"]
    return (batch["points"][..., :3] * plane[:, None, :3]).sum(-1) + plane[:, None, 3]


def test_the_plane_gives_each_point_its_height_in_the_base():
    batch = make_batch()
    assert torch.allclose(heights(batch), batch["in_base"][..., 2], atol=1e-5)
    raised = TablePlane(height=0.25)(batch.clone())
    assert torch.allclose(heights(raised), batch["in_base"][..., 2] - 0.25, atol=1e-5)


def test_a_mirror_changes_no_height():
    batch = make_batch(64)
    mirrored = RandomMirror()(batch.clone())
    assert (mirrored["table_plane"] != batch["table_plane"]).any()
    assert torch.allclose(heights(mirrored), heights(batch), atol=1e-5)


def make_networks() -> list:
    torch.manual_seed(1)
    options = {"table_input": True}
    return [
        GraspActor(PointNet, **options),
        GraspCritic(PointNet, **options),
        GoalPredictor(PointNet, **options),
    ]


@pytest.mark.parametrize("network", make_networks(), ids=lambda each: type(each).__name__)
def test_networks_see_where_the_table_is(network):
    batch = make_batch()
    (key,) = network.out_keys[:1]
    moved = network(batch.clone().set("table_plane", batch["table_plane"].roll(1, dims=0)))
    assert not torch.allclose(network(batch.clone())[key], moved[key])


def test_points_carry_their_heights_into_the_encoder():
    seen = []

    class Recorder(torch.nn.Module):
        out_features = 3

        def forward(self, points):
            seen.append(points)
            return points[..., :3].mean(-2)

    batch = make_batch()
    GraspActor(Recorder(), table_input=True)(batch)
    assert torch.allclose(seen[0][..., -1], batch["in_base"][..., 2] / 0.1, atol=1e-4)


def test_pictures_have_no_heights_but_their_policies_know_the_table():
    def make_encoder(channels):
        return ResNet18(channels, width=0.125)

    actor = GraspActor(make_encoder, in_channels=3, table_input=True, in_keys=["image", "time_left"])
    batch = make_batch(2).set("image", torch.rand(2, 3, 32, 32))
    moved = batch.clone().set("table_plane", batch["table_plane"].flip(0))
    assert actor.module.encoder.in_channels == 3
    assert not torch.allclose(actor(batch)["action"], actor(moved)["action"])
