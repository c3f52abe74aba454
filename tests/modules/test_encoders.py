"""The encoders of clouds: batches, masks, invariances, precisions, vmap, compilers."""

import warnings
from functools import partial

import pytest
import torch
from torch import nn

from torchgrasp.errors import ConfigError
from torchgrasp.modules import PointNet, PointNet2, layers
from torchgrasp.modules.plain_pointnet2 import PlainPointNet2

ENCODERS = [PointNet, PointNet2]
NORMS = ["none", "layer", "group", "batch"]


def _clouds(*batch, num=80, channels=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    clouds = torch.rand(*batch, num, channels, generator=generator)
    return torch.cat((0.1 * clouds[..., :3], clouds[..., 3:].round()), dim=-1)


def _gradients(module, loss):
    module.zero_grad()
    loss.backward()
    return torch.cat([p.grad.flatten() for p in module.parameters()])


@pytest.mark.parametrize("make", ENCODERS)
def test_any_batch_shape(make):
    encoder, clouds = make(4), _clouds(2, 3)
    features = encoder(clouds)
    assert features.shape == (2, 3, encoder.out_features)
    torch.testing.assert_close(encoder(clouds[1, 2]), features[1, 2], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("make", ENCODERS)
@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("batch", [(0,), (2, 0)])
def test_an_empty_batch(make, norm, batch):
    encoder = make(4, norm=norm).eval()
    features = encoder(torch.rand(*batch, 50, 4))
    assert features.shape == (*batch, encoder.out_features)
    features.sum().backward()


@pytest.mark.parametrize("make", ENCODERS)
@pytest.mark.parametrize("channels", [3, 4, 10])
def test_any_channels(make, channels):
    assert make(channels)(_clouds(2, channels=channels)).isfinite().all()


@pytest.mark.parametrize("make", ENCODERS)
@pytest.mark.parametrize("norm", NORMS)
def test_order_of_points_does_not_matter(make, norm):
    encoder, clouds = make(4, norm=norm).double(), _clouds(3).double()
    order = torch.randperm(80, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(encoder(clouds), encoder(clouds[:, order]))


@pytest.mark.parametrize("make", ENCODERS)
def test_repeated_points_change_nothing(make):
    """PointNet's centroid does not move where each point is repeated as often."""
    encoder, clouds = make(4), _clouds(3, num=30)
    order = torch.randperm(60, generator=torch.Generator().manual_seed(1))
    repeated = clouds.repeat(1, 2, 1)[:, order]
    torch.testing.assert_close(encoder(repeated), encoder(clouds), rtol=1e-4, atol=1e-6)


def test_a_repeated_point_changes_nothing_of_pointnet2():
    encoder, clouds = PointNet2(4), _clouds(3, num=50)
    repeated = torch.cat((clouds, clouds[:, 7:8].expand(-1, 9, -1)), dim=1)
    torch.testing.assert_close(encoder(repeated), encoder(clouds), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("make", [PointNet, PointNet2, partial(PointNet2, norm="layer")])
def test_padding_changes_neither_values_nor_gradients(make):
    """Clouds of 80, 45 and 20 points, padded with what must not be looked at."""
    encoder, clouds = make(4).double(), _clouds(3).double()
    sizes = (80, 45, 20)
    mask = torch.arange(80) < torch.tensor(sizes)[:, None]
    order = torch.randperm(80, generator=torch.Generator().manual_seed(1))
    padded = torch.where(mask[..., None], clouds, torch.nan)[:, order]
    alone = torch.stack([encoder(cloud[:n]) for cloud, n in zip(clouds, sizes, strict=True)])
    expected = _gradients(encoder, alone.square().sum())
    features = encoder(padded, mask[:, order])
    torch.testing.assert_close(features, alone)
    torch.testing.assert_close(_gradients(encoder, features.square().sum()), expected)


@pytest.mark.parametrize("make", ENCODERS)
def test_a_cloud_without_points_is_its_first_row(make):
    encoder, clouds = make(4), _clouds(1, num=40)
    clouds[:] = clouds[:, :1]
    torch.testing.assert_close(encoder(clouds, torch.zeros(1, 40).bool()), encoder(clouds))


@pytest.mark.parametrize("make", ENCODERS)
@pytest.mark.parametrize("num", [1, 5, 40])
def test_degenerate_clouds_give_finite_gradients(make, num):
    encoder = make(4)
    clouds = _clouds(2, num=1).expand(2, num, 4)
    encoder(clouds).square().sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in encoder.parameters())


@pytest.mark.parametrize("norm", ["none", "batch"])
@pytest.mark.parametrize("start", ["first", "outermost"])
def test_pointnet2_equals_the_plain_construction(norm, start):
    """Group first, then every layer on every row with a graph, then max: no rearrangement, no saving."""
    torch.manual_seed(1)
    encoder = PointNet2(5, width=0.25, norm=norm, start=start).double()
    plain = PlainPointNet2(encoder).double()
    clouds = _clouds(3, num=150, channels=5).double()
    features, expected = encoder(clouds), plain(clouds)
    torch.testing.assert_close(features, expected)
    weights = torch.rand(features.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    found = _gradients(encoder, (features * weights).sum())
    assert found.any()
    torch.testing.assert_close(found, _gradients(plain, (expected * weights).sum()))


@pytest.mark.parametrize("make", ENCODERS)
def test_gradients_are_those_of_finite_differences(make):
    torch.manual_seed(0)
    encoder = make(3, 4, width=0.1).double()
    cloud = _clouds(num=12, channels=3).double().requires_grad_()
    assert torch.autograd.gradcheck(encoder, cloud)


@pytest.mark.parametrize("make", ENCODERS)
def test_autocast_keeps_the_gradients(make):
    """Weights that autocast cast in the pass without a graph must not serve the pass with one."""
    torch.manual_seed(0)
    encoder, clouds = make(4, width=0.5), _clouds(4, num=200)
    expected = encoder(clouds)
    gradient = _gradients(encoder, expected.square().sum())
    with torch.autocast("cpu", dtype=torch.bfloat16):
        features = encoder(clouds)
    assert ((features - expected).norm() / expected.norm()).item() < 0.02
    found = _gradients(encoder, features.float().square().sum())
    assert nn.functional.cosine_similarity(found, gradient, dim=0).item() > 0.99


def test_bfloat16_is_warned_of_once_where_it_is_slow():
    layers._warn_of_slow_bfloat16.cache_clear()
    encoder = PointNet(4, width=0.1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        encoder(_clouds(1))
        assert not caught
        with torch.autocast("cpu", dtype=torch.bfloat16):
            encoder(_clouds(1))
            encoder(_clouds(1))
    slow = not torch.ops.mkldnn._is_mkldnn_bf16_supported()
    assert sum("bfloat16" in str(warning.message) for warning in caught) == slow


@pytest.mark.parametrize("make", ENCODERS)
def test_weights_and_clouds_in_bfloat16(make):
    torch.manual_seed(0)
    encoder, clouds = make(4, width=0.5), _clouds(4, num=200).bfloat16()
    expected = encoder(clouds.float())
    features = encoder.bfloat16()(clouds)
    assert features.dtype == torch.bfloat16
    assert ((features.float() - expected).norm() / expected.norm()).item() < 0.05


@pytest.mark.parametrize("make", ENCODERS)
@pytest.mark.parametrize("norm", ["none", "layer", "group"])
def test_gradients_of_each_sample_by_vmap(make, norm):
    torch.manual_seed(0)
    encoder, clouds = make(4, 32, width=0.25, norm=norm), _clouds(3)
    params = {name: value.detach() for name, value in encoder.named_parameters()}

    def loss(params, cloud):
        return torch.func.functional_call(encoder, params, cloud).square().sum()

    found = torch.func.vmap(torch.func.grad(loss), (None, 0))(params, clouds)
    for i, cloud in enumerate(clouds):
        expected = torch.func.grad(loss)(params, cloud)
        for name, value in expected.items():
            torch.testing.assert_close(found[name][i], value, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("make", ENCODERS)
def test_several_sets_of_weights_by_vmap(make):
    torch.manual_seed(0)
    encoders, clouds = [make(4, 8, width=0.1) for _ in range(3)], _clouds(2)
    params, buffers = torch.func.stack_module_state(encoders)

    def run(params, buffers):
        return torch.func.functional_call(encoders[0], (params, buffers), clouds)

    expected = torch.stack([encoder(clouds) for encoder in encoders])
    torch.testing.assert_close(torch.vmap(run)(params, buffers), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("make", ENCODERS)
def test_compiles_as_one_graph(make):
    torch.manual_seed(0)
    encoder, clouds = make(4, 16, width=0.25), _clouds(3)
    mask = torch.arange(80) < torch.tensor([[80], [50], [31]])
    compiled = torch.compile(encoder, backend="aot_eager", fullgraph=True)
    expected, features = encoder(clouds, mask), compiled(clouds, mask)
    torch.testing.assert_close(features, expected, rtol=1e-4, atol=1e-6)
    gradient = _gradients(encoder, expected.square().sum())
    torch.testing.assert_close(_gradients(encoder, features.square().sum()), gradient, rtol=1e-3, atol=1e-5)


def test_a_random_start_follows_torchs_generator():
    encoder, clouds = PointNet2(4, start="random"), _clouds(3, num=200)
    draws = []
    for seed in (0, 0, 1):
        torch.manual_seed(seed)
        draws.append(encoder(clouds))
    assert torch.equal(draws[0], draws[1])
    assert not torch.equal(draws[0], draws[2])


@pytest.mark.parametrize(
    ("options", "parameters"),
    [({}, 1.40e6), ({"width": 0.5, "neighbours": (32, 16)}, 0.481e6)],
)
def test_pointnet2_has_its_presets_sizes(options, parameters):
    """1.40 M parameters, 5.6 MB (released code)."""
    count = sum(p.numel() for p in PointNet2(4, **options).parameters())
    assert count == pytest.approx(parameters, rel=0.01)


def test_width_scales_inner_layers_only():
    narrow, wide = PointNet2(4, width=0.5), PointNet2(4, width=2.0)
    assert narrow.out_features == wide.out_features == 512
    assert narrow.whole[0].out_features == 128
    assert wide.whole[0].out_features == 512


def test_no_batch_norm_by_default():
    assert not any(isinstance(m, nn.BatchNorm1d) for make in ENCODERS for m in make(4).modules())


def test_a_norm_makes_every_group_of_channels_standard():
    """Rows of two groups of 16 channels: mean 0 and variance 1 in each."""
    norm = PointNet2(4, width=0.25, norm="group").abstractions[0].rest[-2]
    rows = norm(3 + 5 * torch.randn(2, 6, 32)).unflatten(-1, (2, 16))
    assert norm.num_groups == 2
    torch.testing.assert_close(rows.mean(dim=-1), torch.zeros(2, 6, 2), rtol=0, atol=1e-5)
    torch.testing.assert_close(rows.var(dim=-1, unbiased=False), torch.ones(2, 6, 2), rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: PointNet(2), "in_channels=2"),
        (lambda: PointNet2(4, width=0), "width=0"),
        (lambda: PointNet2(4, norm="instance"), "norm='instance'"),
        (lambda: PointNet2(4, centres=(32,)), "centres"),
        (lambda: PointNet2(4, neighbours=(0, 16)), "num_neighbours=0"),
        (lambda: PointNet2(4, start="last"), "start='last'"),
        (lambda: PointNet(4, hidden=()), "hidden"),
        (lambda: PointNet(4, 0), "out_features=0"),
        (lambda: PointNet2(4, norm="batch")(_clouds(2), torch.ones(2, 80).bool()), "norm='batch'"),
        (lambda: PointNet2(4)(_clouds(2, channels=3)), r"\(2, 80, 3\)"),
        (lambda: PointNet(4)(_clouds(2), torch.ones(2, 79).bool()), r"mask \(2, 79\)"),
        (lambda: PlainPointNet2(PointNet2(4, norm="layer")), "LayerNorm"),
    ],
)
def test_wrong_options_are_refused(wrong, message):
    with pytest.raises(ConfigError, match=message):
        wrong()
