"""Clouds and pictures as rows keep them, and pictures through a whole buffer."""

import pytest
import torch
from tensordict import TensorDict

from tests.data.rollouts import make_rollout
from torchgrasp.data import CompactTransitions, MixtureReplayBuffer
from torchgrasp.data.encodings import CloudEncoding, ImageEncoding
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import gripper_control_points
from torchgrasp.transforms import CameraImage


def make_pictures(*shape: int, seed: int = 0) -> TensorDict:
    """(*) views of a camera that renders."""
    generator = torch.Generator().manual_seed(seed)
    depth = 2.0 * torch.rand(*shape, 8, 8, generator=generator)
    mask = torch.rand(*shape, 8, 8, generator=generator) < 0.3
    rgb = torch.randint(256, (*shape, 8, 8, 3), generator=generator).to(torch.uint8)
    return TensorDict({"camera": {"depth": depth, "mask": mask, "rgb": rgb}}, shape)


@pytest.mark.parametrize("channels", ["rgb", "rgbd", "rgbdm", "d", "dm"])
def test_pictures_of_a_camera_come_back(channels):
    images = torch.stack(
        [CameraImage(channels, size=8)(make_pictures(5, seed=seed))["image"] for seed in range(3)]
    )
    encoding = ImageEncoding("image", channels)
    stored = encoding.encode(images)
    assert stored.dtype == torch.uint8
    assert stored.shape == (3, 5, len(channels) + ("d" in channels), 8, 8)
    back = encoding.decode(stored)
    for plane, letter in enumerate(channels):
        wanted, found = images[..., plane, :, :], back[..., plane, :, :]
        if letter == "d":
            assert torch.equal(found, wanted.half().float())
            assert (found - wanted).abs().max() <= 5e-4
        else:
            assert torch.equal(found, wanted)


def test_every_byte_of_a_colour_is_exact():
    levels = (torch.arange(256, dtype=torch.uint8).float() / 255.0).reshape(1, 1, 16, 16)
    encoding = ImageEncoding("image", "r")
    assert torch.equal(encoding.decode(encoding.encode(levels)), levels)
    assert encoding.encode(levels).reshape(-1).tolist() == list(range(256))


def test_pictures_go_through_a_buffer_with_their_next_states():
    codec = CompactTransitions(points_key=None, image_channels="rgbd")
    buffer = MixtureReplayBuffer({"online": 200}, {"online": 1.0}, batch_size=128, codec=codec)
    rollout = make_rollout(4, 20, generator=torch.Generator().manual_seed(1))
    images = torch.randint(256, (4, 21, 4, 6, 6), generator=torch.Generator().manual_seed(2)).float() / 255.0
    rollout = rollout.exclude("points", ("next", "points"))
    rollout["image"], rollout["next", "image"] = images[:, :-1], images[:, 1:]
    buffer.extend(rollout)
    wanted = {step["time_left"].item(): step for step in rollout.reshape(-1).unbind(0)}
    for row in buffer.sample().unbind(0):
        step = wanted[row["time_left"].item()]
        assert torch.equal(row["image"][:3], step["image"][:3])
        assert torch.equal(row["image"][3], step["image"][3].half().float())
        if not step["next", "done"]:
            assert torch.equal(row["next", "image"][:3], step["next", "image"][:3])


def test_a_pixel_of_colour_and_depth_takes_five_bytes():
    codec = CompactTransitions(points_key=None, image_channels="rgbd")
    row = codec.example_row({"image": (4, 112, 112), "time_left": (1,)})
    assert row["image"].numel() * row["image"].element_size() == 5 * 112 * 112


def test_clouds_lose_a_quarter_of_a_millimetre_at_most():
    cloud = torch.rand(20, 106, 4)
    cloud[:, :100, 3] = 0.0
    cloud[:, 100:, :3], cloud[:, 100:, 3] = gripper_control_points(), 1.0
    encoding = CloudEncoding("points", gripper_points=True)
    stored = encoding.encode(cloud)
    assert stored.shape == (20, 100, 3) and stored.dtype == torch.float16
    back = encoding.decode(stored)
    assert (back - cloud).abs().max() <= 2**-12
    assert torch.equal(back[:, 100:], cloud[:, 100:]) and torch.equal(back[..., 3], cloud[..., 3])


def make_hand_cloud(dtype: torch.dtype) -> torch.Tensor:
    """(2, 16, 4) clouds of coordinates that every type below holds exactly, and the gripper's points."""
    cloud = torch.zeros(2, 16, 4)
    cloud[:, :10, :3] = torch.arange(60).reshape(2, 10, 3) / 64
    cloud[:, 10:, :3], cloud[:, 10:, 3] = gripper_control_points(), 1.0
    return cloud.to(dtype)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16])
def test_clouds_of_any_floating_type_are_stored(dtype):
    encoding = CloudEncoding("points", gripper_points=True)
    back = encoding.decode(encoding.encode(make_hand_cloud(dtype)))
    assert torch.equal(back, make_hand_cloud(torch.float32))


@pytest.mark.parametrize("value", [7e4, -7e4, float("inf"), float("nan")])
def test_values_that_float16_does_not_hold_are_refused(value):
    for gripper_points in (True, False):
        cloud = make_hand_cloud(torch.float32)
        cloud[1, 3, 2] = value
        with pytest.raises(ConfigError, match=r"'points' holds values .* 65504"):
            CloudEncoding("points", gripper_points=gripper_points).encode(cloud)
    with pytest.raises(ConfigError, match="'image' holds values"):
        ImageEncoding("image", "d").encode(torch.full((1, 1, 2, 2), value))
    largest = torch.full((1, 2, 3), 65504.0)
    assert torch.equal(CloudEncoding("points", gripper_points=False).encode(largest).float(), largest)


def test_pictures_that_do_not_fit_are_refused():
    encoding = ImageEncoding("image", "rgb")
    with pytest.raises(ConfigError, match="3 planes"):
        encoding.encode(torch.zeros(2, 4, 8, 8))
    with pytest.raises(ConfigError, match="normalise"):
        encoding.encode(torch.full((2, 3, 8, 8), -0.5))
    for channels in ("", "rgbx", "rr"):
        with pytest.raises(ConfigError, match="image_channels"):
            ImageEncoding("image", channels)
