"""The wrist's angle beside the cloud, what mirrors make of it, and networks that read such observations."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic, PointNet
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import RandomMirror, WristAngle

LIMIT = 2.8973  # radians, either way


def make_batch(n: int = 64) -> TensorDict:
    torch.manual_seed(0)
    cloud = torch.cat((torch.randn(n, 20, 3), torch.zeros(n, 20, 1)), dim=-1)
    state = {"points": cloud, "time_left": torch.rand(n, 1), "wrist_angle": 5.8 * torch.rand(n, 1) - 2.9}
    return TensorDict({**state, "joints": torch.randn(n, 9), "action": 0.1 * torch.randn(n, 6)}, [n])


def test_a_turn_about_the_hands_axis_is_a_turn_of_the_wrist():
    objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
    camera = RaycastCamera(CameraIntrinsics(12, 12))
    env = TransformedEnv(GraspEnv(2, objects=objects, camera=camera, seed=0), WristAngle())
    td = env.reset()
    turn = torch.tensor([0.1, -0.1])
    action = torch.zeros(2, 6)
    action[:, 5] = turn
    after = env.step(td.clone().set("action", action))["next", "wrist_angle"]
    assert after.shape == (2, 1) and after.dtype == torch.float32
    assert torch.allclose(after[:, 0] - td["wrist_angle"][:, 0], turn, atol=0.03)  # other joints take a part


def test_a_mirror_leaves_a_turn_as_far_from_the_wrists_stop():
    batch = make_batch()
    mirrored = RandomMirror()(batch.clone())
    same = mirrored["wrist_angle"] == batch["wrist_angle"]
    assert same.any() and not same.all()
    for each in (1.0, -1.0):  # what is left on the side that the action turns to
        stop = each * LIMIT
        side, side_mirrored = (td["action"][:, 5].sign() == each for td in (batch, mirrored))
        left = (stop - batch["wrist_angle"][side, 0]).abs()
        flipped = torch.where(side_mirrored[side], stop, -stop) - mirrored["wrist_angle"][side, 0]
        assert torch.allclose(flipped.abs(), left)


def make_networks(inputs: dict | None) -> list:
    torch.manual_seed(1)
    return [each(PointNet, state_inputs=inputs) for each in (GraspActor, GraspCritic, GoalPredictor)]


@pytest.mark.parametrize("number", range(3))
def test_networks_read_what_they_are_given(number):
    network, plain = make_networks({"wrist_angle": 1, "joints": 9})[number], make_networks(None)[number]
    assert set(network.in_keys) - set(plain.in_keys) == {"wrist_angle", "joints"}
    batch, key = make_batch(8), network.out_keys[0]
    before = network(batch.clone())[key]
    for name in ("wrist_angle", "joints"):
        assert not torch.allclose(before, network(batch.clone().set(name, batch[name].roll(1, dims=0)))[key])


@pytest.mark.parametrize("inputs", [{"joints": 0}, {"joints": True}, {"joints": "nine"}, ["joints"]])
def test_sizes_that_are_none_are_refused(inputs):
    with pytest.raises(ConfigError, match="state_inputs"):
        GraspActor(PointNet, state_inputs=inputs)
