"""Both encoders: any batch shape, the order of points, sizes, gradients, degenerate clouds."""

import pytest
import torch
from torch import nn

from torchgrasp.errors import ConfigError
from torchgrasp.modules import PointNet, PointNet2

ENCODERS = [PointNet, PointNet2]


def _clouds(*batch, num=80, channels=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    clouds = torch.rand(*batch, num, channels, generator=generator)
    return torch.cat((0.1 * clouds[..., :3], clouds[..., 3:].round()), dim=-1)


@pytest.mark.parametrize("make", ENCODERS)
def test_any_batch_shape(make):
    encoder, clouds = make(4), _clouds(2, 3)
    features = encoder(clouds)
    assert features.shape == (2, 3, encoder.out_features)
    torch.testing.assert_close(encoder(clouds[1, 2]), features[1, 2], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("make", ENCODERS)
@pytest.mark.parametrize("channels", [3, 4, 10])
def test_any_channels(make, channels):
    assert make(channels)(_clouds(2, channels=channels)).isfinite().all()


@pytest.mark.parametrize("make", ENCODERS)
def test_order_of_points_does_not_matter(make):
    """Beyond the first point, from which PointNet++ starts its sampling."""
    encoder, cloud = make(4), _clouds(1)
    order = torch.cat((torch.tensor([0]), 1 + torch.randperm(79)))
    torch.testing.assert_close(encoder(cloud), encoder(cloud[:, order]), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("make", ENCODERS)
@pytest.mark.parametrize("num", [1, 5, 40])
def test_degenerate_clouds_give_finite_gradients(make, num):
    encoder = make(4)
    clouds = _clouds(2, num=1).expand(2, num, 4)
    encoder(clouds).square().sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in encoder.parameters())


@pytest.mark.parametrize("norm", ["none", "layer", "batch"])
def test_pointnet2_equals_the_plain_construction(norm):
    """Group first, then every layer on every row, then max: no rearrangement, no saving."""
    torch.manual_seed(1)
    encoder = PointNet2(5, width=0.25, norm=norm).double().eval()
    clouds = _clouds(2, channels=5).double()
    xyz, features = clouds[..., :3], clouds[..., 3:]
    for stage in encoder.abstractions:
        centres = stage._centres(xyz)
        pooled = torch.empty(
            *centres.shape[:2], stage.rest[-2 if norm == "none" else -3].out_features
        ).double()
        for b, m in [(b, m) for b in range(2) for m in range(centres.shape[1])]:
            offset = xyz[b] - centres[b, m]
            inside = offset.norm(dim=-1) <= stage.radius
            nearest = offset.norm(dim=-1).argsort()[: stage.num_neighbours]
            chosen = nearest[inside[nearest]]
            rows = torch.cat((offset[chosen] / stage.radius, features[b, chosen]), dim=-1)
            pooled[b, m] = stage.rest(stage.first(rows)).amax(dim=0)
        xyz, features = centres, pooled
    rows = torch.cat((xyz / encoder.scale, features), dim=-1)
    whole = encoder.whole(rows.flatten(0, 1)).unflatten(0, rows.shape[:2]).amax(dim=1)
    torch.testing.assert_close(encoder(clouds), encoder.cloud(whole))


def test_pointnet2_has_the_released_size():
    """1.40 M parameters, 5.6 MB (released code)."""
    assert sum(p.numel() for p in PointNet2(4).parameters()) == pytest.approx(1.40e6, rel=0.01)


def test_width_scales_inner_layers_only():
    narrow, wide = PointNet2(4, width=0.5), PointNet2(4, width=2.0)
    assert narrow.out_features == wide.out_features == 512
    assert narrow.whole[0].out_features == 128
    assert wide.whole[0].out_features == 512


def test_no_batch_norm_by_default():
    assert not any(isinstance(m, nn.BatchNorm1d) for make in ENCODERS for m in make(4).modules())


@pytest.mark.parametrize(
    "wrong", [lambda: PointNet(2), lambda: PointNet2(4, width=0), lambda: PointNet2(4, norm="group")]
)
def test_wrong_options_are_refused(wrong):
    with pytest.raises(ConfigError):
        wrong()
