"""ResNet18: the public names and numbers, the function, weights of other channels, errors."""

from functools import partial
from itertools import product

import pytest
import torch
from safetensors.torch import save_file
from torch.func import functional_call, stack_module_state
from torch.nn import functional

from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.modules import ResNet18

NARROW = partial(ResNet18, width=0.25)
NORM = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")


def public_names():
    """torchvision's: two blocks of two convolutions a stage, a shortcut at the head of stages 2, 3 and 4."""
    names = ["conv1.weight", *(f"bn1.{each}" for each in NORM)]
    for stage in (1, 2, 3, 4):
        for block in (0, 1):
            place = f"layer{stage}.{block}"
            for number in (1, 2):
                names += [f"{place}.conv{number}.weight", *(f"{place}.bn{number}.{each}" for each in NORM)]
            if stage > 1 and block == 0:
                names += [f"{place}.downsample.0.weight", *(f"{place}.downsample.1.{each}" for each in NORM)]
    return names


def public_file(path, width=0.25, channels=3):
    """A file as converted from torchvision: random weights and statistics, classifier included."""
    torch.manual_seed(3)
    state = ResNet18(channels, width=width, norm="batch").state_dict()
    state = {k: v if v.ndim == 0 else v + 0.1 * torch.rand_like(v) for k, v in state.items()}
    classifier = {"fc.weight": torch.rand(1000, len(state["layer4.1.bn2.bias"])), "fc.bias": torch.rand(1000)}
    save_file(state | classifier, path)
    return state


def test_it_has_the_public_number_of_parameters():
    """11,689,512 (torchvision), 513,000 of them the classifier's."""
    assert sum(p.numel() for p in ResNet18().parameters()) == 11_689_512 - (512 + 1) * 1000


@pytest.mark.parametrize("norm", ["batch", "frozen"])
def test_names_are_the_public_ones(norm):
    names = list(ResNet18(norm=norm).state_dict())
    assert sorted(names) == sorted(public_names())
    assert {
        *("conv1.weight", "bn1.running_mean", "layer1.0.conv1.weight", "layer1.1.bn2.num_batches_tracked"),
        *("layer2.0.downsample.0.weight", "layer2.0.downsample.1.running_var", "layer4.1.conv2.weight"),
    } <= set(names)
    assert len(names) == 122 - 2
    assert not {"layer1.0.downsample.0.weight", "layer3.1.downsample.0.weight"} & set(names)


def test_shapes_are_the_public_ones():
    shapes = {name: tuple(value.shape) for name, value in ResNet18(norm="batch").state_dict().items()}
    assert shapes["conv1.weight"] == (64, 3, 7, 7)
    assert shapes["layer2.0.downsample.0.weight"] == (128, 64, 1, 1)
    assert shapes["layer3.0.conv1.weight"] == (256, 128, 3, 3)
    assert shapes["layer4.1.bn2.running_var"] == (512,)


@pytest.mark.parametrize("norm", ["batch", "frozen"])
def test_it_equals_torchs_functions_put_together(norm, tmp_path):
    p = public_file(tmp_path / "public.safetensors")

    def convolve(x, name, stride=1):
        weight = p[f"{name}.weight"]
        return functional.conv2d(x, weight, stride=stride, padding=weight.shape[-1] // 2)

    def normalise(x, name):
        stored = (p[f"{name}.{each}"] for each in ("running_mean", "running_var", "weight", "bias"))
        return functional.batch_norm(x, *stored)

    images = torch.rand(2, 3, 40, 48)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    x = ((images.movedim(1, -1) - mean) / std).movedim(-1, 1)
    x = functional.max_pool2d(normalise(convolve(x, "conv1", 2), "bn1").relu(), 3, 2, 1)
    for stage, block in product((1, 2, 3, 4), (0, 1)):
        place, stride = f"layer{stage}.{block}", 2 if stage > 1 and block == 0 else 1
        y = normalise(convolve(x, f"{place}.conv1", stride), f"{place}.bn1").relu()
        y = normalise(convolve(y, f"{place}.conv2"), f"{place}.bn2")
        if stride == 2:
            x = normalise(convolve(x, f"{place}.downsample.0", 2), f"{place}.downsample.1")
        x = (x + y).relu()
    encoder = NARROW(norm=norm, weights=tmp_path / "public.safetensors").eval()
    pooled = functional.adaptive_avg_pool2d(x, 1).flatten(1)
    torch.testing.assert_close(encoder(images), pooled, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,)])
def test_any_batch_shape(shape):
    encoder, images = NARROW(4).eval(), torch.rand(*shape, 4, 32, 32)
    assert encoder(images).shape == (*shape, 128)


def test_images_of_a_batch_are_treated_alone():
    """With GroupNorm or stored statistics: a batch of one is as good as any."""
    images = torch.rand(5, 3, 32, 32)
    for norm in ("group", "frozen"):
        encoder = NARROW(norm=norm).train()
        torch.testing.assert_close(encoder(images)[2:3], encoder(images[2:3]), rtol=1e-4, atol=1e-5)


def test_frozen_statistics_stay_in_training_and_batch_statistics_move():
    for norm, moves in (("frozen", False), ("batch", True)):
        encoder = NARROW(norm=norm).train()
        before = encoder.bn1.running_mean.clone()
        encoder(torch.rand(4, 3, 32, 32))
        assert torch.equal(encoder.bn1.running_mean, before) is not moves


def test_colours_are_standardised_and_other_channels_are_not():
    plain, both = NARROW(5, standardize=False), NARROW(5)
    both.load_state_dict(plain.state_dict())
    images = torch.rand(2, 5, 32, 32)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    given = images.clone()
    given[:, :3] = (images[:, :3] - mean[:, None, None]) / std[:, None, None]
    torch.testing.assert_close(both(images), plain(given), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("norm", ["batch", "frozen", "group"])
def test_extra_channels_start_at_zero(norm, tmp_path):
    """RGB weights in a network of RGB, depth, mask and six channels of an action."""
    path = tmp_path / "public.safetensors"
    state = public_file(path)
    wide, narrow = (NARROW(channels, norm=norm, weights=path).eval() for channels in (11, 3))
    assert torch.equal(wide.conv1.weight[:, :3], state["conv1.weight"])
    assert wide.conv1.weight[:, 3:].abs().max() == 0
    images = torch.rand(2, 11, 32, 32)
    torch.testing.assert_close(wide(images), narrow(images[:, :3]), rtol=1e-4, atol=1e-5)
    wide(images).square().sum().backward()
    assert (wide.conv1.weight.grad[:, 3:].abs().amax(dim=(0, 2, 3)) > 0).all()


def test_depth_and_mask_alone():
    assert NARROW(2, rgb=False)(torch.rand(1, 2, 32, 32)).shape == (1, 128)


def test_width_scales_to_whole_groups():
    assert ResNet18(width=0.5).out_features == 256
    assert ResNet18(width=0.01).out_features == ResNet18(width=0.25).out_features == 128


@pytest.mark.parametrize("norm", ["group", "frozen"])
def test_vmap_over_weights_equals_a_loop(norm):
    networks, images = [NARROW(norm=norm) for _ in range(2)], torch.rand(2, 3, 32, 32)
    params, buffers = stack_module_state(networks)
    at_once = torch.vmap(lambda p, b: functional_call(networks[0], (p, b), (images,)))(params, buffers)
    torch.testing.assert_close(at_once, torch.stack([n(images) for n in networks]), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: ResNet18(2), "in_channels=2"),
        (lambda: ResNet18(0), "in_channels=0"),
        (lambda: ResNet18(norm="layer"), "norm='layer'"),
        (lambda: ResNet18(width=0), "width=0"),
        (lambda: ResNet18(3, rgb=False, weights="a.safetensors"), "rgb=False"),
        (lambda: ResNet18(weights="resnet18.pth"), r"torch.load\('resnet18.pth', weights_only=True\)"),
    ],
)
def test_wrong_options_are_refused(wrong, message):
    with pytest.raises(ConfigError, match=message):
        wrong()


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (torch.rand(2, 1, 32, 32), "encoder of 3 channels"),
        (torch.rand(2, 32, 32, 3), "encoder of 3 channels"),
        (torch.rand(32, 32), "encoder of 3 channels"),
        (torch.ones(2, 3, 32, 32, dtype=torch.uint8), "divided by 255"),
    ],
)
def test_wrong_images_are_refused(images, message):
    with pytest.raises(ConfigError, match=message):
        NARROW()(images)


def test_wrong_files_are_refused(tmp_path):
    with pytest.raises(CheckpointError, match="no weights file"):
        ResNet18(weights=tmp_path / "absent.safetensors")
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes(b"nothing")
    with pytest.raises(CheckpointError, match="damaged"):
        ResNet18(weights=damaged)
    other = tmp_path / "other.safetensors"
    save_file({"layer.weight": torch.rand(2, 2)}, other)
    with pytest.raises(CheckpointError, match=r"conv1\.weight"):
        ResNet18(weights=other)
    narrow = tmp_path / "narrow.safetensors"
    public_file(narrow)
    with pytest.raises(CheckpointError, match="width=1"):
        ResNet18(weights=narrow)
    five = tmp_path / "five.safetensors"
    public_file(five, channels=5)
    with pytest.raises(CheckpointError, match="input channels"):
        NARROW(weights=five)
