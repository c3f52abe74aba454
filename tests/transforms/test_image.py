import pytest
import torch
from tensordict import TensorDict

from torchgrasp.errors import ConfigError
from torchgrasp.transforms import CameraImage


def pictures(*batch: int, size: int = 8) -> TensorDict:
    generator = torch.Generator().manual_seed(0)
    rgb = torch.randint(0, 256, (*batch, size, size, 3), generator=generator, dtype=torch.uint8)
    depth = 4 * torch.rand(*batch, size, size, generator=generator)
    return TensorDict({"camera": {"rgb": rgb, "depth": depth, "mask": depth > 2}}, list(batch))


def test_channels_come_in_their_order_and_units():
    td = pictures(2, 3)
    image = CameraImage("rgbdm", size=8, far=2.5)(td)["image"]
    assert image.shape == (2, 3, 5, 8, 8) and image.dtype == torch.float32
    assert torch.allclose(image[..., 1, :, :] * 255, td["camera", "rgb"][..., 1].float())
    assert torch.equal(image[..., 3, :, :], td["camera", "depth"].clamp_max(2.5))
    assert torch.equal(image[..., 4, :, :].bool(), td["camera", "mask"])


@pytest.mark.parametrize(("channels", "count"), [("rgb", 3), ("rgbd", 4), ("rgbdm", 5), ("d", 1), ("dm", 2)])
def test_number_of_channels(channels, count):
    assert CameraImage(channels, size=8)(pictures(2))["image"].shape == (2, count, 8, 8)


def test_resizing_averages_colours_and_mixes_no_depths():
    td = pictures()
    image = CameraImage("rgbd", size=4, far=9.0)(td)["image"]
    corner = td["camera", "rgb"][:2, :2].float().mean((0, 1)) / 255
    assert torch.allclose(image[:3, 0, 0], corner)
    assert set(image[3].flatten().tolist()) <= set(td["camera", "depth"].flatten().tolist())


def test_without_colours_it_names_the_camera_to_choose():
    with pytest.raises(ConfigError, match="give the env a RenderCamera"):
        CameraImage("rgb")(pictures().exclude(("camera", "rgb")))


@pytest.mark.parametrize(("options"), [{"channels": "bgr"}, {"size": 0}, {"far": 0.0}, {"camera": "head"}])
def test_impossible_options_are_refused(options):
    with pytest.raises(ConfigError):
        CameraImage(**options)
