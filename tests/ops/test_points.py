"""The fast point operations against their definitions, on clouds that provoke ties."""

import pytest
import torch

from torchgrasp.errors import ConfigError
from torchgrasp.ops import ball_query, definitions, farthest_point_sample, group

CLOUDS = {
    "random": lambda g: torch.rand(3, 40, 3, generator=g) * 0.1,
    "duplicates": lambda g: torch.rand(3, 10, 3, generator=g).repeat(1, 4, 1) * 0.1,
    "grid": lambda g: torch.randint(0, 3, (3, 40, 3), generator=g) * 0.02,
    "one point": lambda g: torch.full((3, 40, 3), 0.3),
    "single": lambda g: torch.rand(3, 1, 3, generator=g),
}
DTYPES = [torch.float32, torch.float64, torch.bfloat16, torch.float16]


@pytest.fixture(params=CLOUDS)
def clouds(request):
    return CLOUDS[request.param](torch.Generator().manual_seed(0))


@pytest.fixture(params=[False, True], ids=["whole", "masked"])
def mask(request, clouds):
    """None, or masks of which one hides the first points and one hides all."""
    if not request.param:
        return None
    mask = torch.rand(clouds.shape[:-1], generator=torch.Generator().manual_seed(1)) < 0.6
    mask[0, 0] = False
    mask[1] = False
    return mask


def _spoil(clouds, mask):
    """The clouds with NaN and infinity where the mask says that there is no point."""
    if mask is None:
        return clouds
    spoilt = torch.tensor([torch.nan, torch.inf, -torch.inf], dtype=clouds.dtype)
    return torch.where(mask[..., None], clouds, spoilt)


def _masks(mask, clouds):
    return [None] * len(clouds) if mask is None else mask


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("num", [1, 8, 48])
def test_sampling_equals_its_definition(clouds, mask, num, dtype):
    clouds = clouds.to(dtype)
    expected = [
        definitions.farthest_point_sample(cloud, num, definitions.outermost_point(cloud, m), m)
        for cloud, m in zip(clouds, _masks(mask, clouds), strict=True)
    ]
    found = farthest_point_sample(_spoil(clouds, mask), num, mask=mask, start="outermost")
    assert torch.equal(found, torch.stack(expected))


def test_sampling_begins_at_the_first_point(clouds, mask):
    expected = [
        definitions.farthest_point_sample(cloud, 8, 0 if m is None else int(m.int().argmax()), m)
        for cloud, m in zip(clouds, _masks(mask, clouds), strict=True)
    ]
    assert torch.equal(farthest_point_sample(_spoil(clouds, mask), 8, mask=mask), torch.stack(expected))


def test_a_random_start_is_a_point_and_the_generators():
    cloud = torch.rand(500, 20, 3, generator=torch.Generator().manual_seed(2))
    mask = torch.arange(20) % 2 == 1

    def first(seed):
        generator = torch.Generator().manual_seed(seed)
        kwargs = {"mask": mask.expand(500, 20), "start": "random", "generator": generator}
        return farthest_point_sample(cloud, 3, **kwargs)[:, 0]

    assert torch.equal(first(0), first(0))
    assert not torch.equal(first(0), first(1))
    counts = torch.bincount(first(0), minlength=20)
    assert (counts[~mask] == 0).all()
    assert (counts[mask] > 25).all()  # 50 expected of each, standard deviation 6.7


def test_sampling_from_the_outermost_point_does_not_know_the_order():
    cloud = torch.rand(4, 60, 3, generator=torch.Generator().manual_seed(3))
    order = torch.randperm(60, generator=torch.Generator().manual_seed(4))
    chosen = cloud.gather(1, farthest_point_sample(cloud, 9, start="outermost")[..., None].expand(-1, -1, 3))
    again = cloud[:, order]
    other = again.gather(1, farthest_point_sample(again, 9, start="outermost")[..., None].expand(-1, -1, 3))
    assert torch.equal(chosen, other)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(("radius", "num"), [(0.02, 4), (0.04, 64), (1.0, 16)])
def test_ball_query_equals_its_definition(clouds, mask, radius, num, dtype):
    clouds = clouds.to(dtype)
    centres = clouds[:, :5] + torch.tensor([0.0, 0.01, 0.0], dtype=dtype)
    expected = [
        definitions.ball_query(p, c, radius, num, m)
        for p, c, m in zip(clouds, centres, _masks(mask, clouds), strict=True)
    ]
    found = ball_query(_spoil(clouds, mask), centres, radius, num, mask=mask)
    assert torch.equal(found, torch.stack(expected))


def test_group_equals_its_definition(clouds):
    features = torch.cat((clouds, clouds.square()), dim=-1)
    index = ball_query(clouds, clouds[:, :5], 0.05, 6)
    expected = torch.stack([definitions.group(f, i) for f, i in zip(features, index, strict=True)])
    assert torch.equal(group(features, index), expected)


def test_any_leading_dimensions(clouds):
    nested = clouds[None, :, None].expand(2, 3, 2, *clouds.shape[-2:])
    index = farthest_point_sample(nested, 4)
    assert index.shape == (2, 3, 2, 4)
    assert torch.equal(index[1, :, 1], farthest_point_sample(clouds, 4))
    assert torch.equal(farthest_point_sample(clouds[0], 4), index[0, 0, 0])
    neighbours = ball_query(nested, nested[..., :1, :], 0.05, 3)
    assert torch.equal(neighbours[1, :, 1], ball_query(clouds, clouds[:, :1], 0.05, 3))


def test_no_clouds_at_all():
    none = torch.empty(0, 5, 3)
    assert farthest_point_sample(none, 4, start="outermost").shape == (0, 4)
    assert ball_query(none, none, 0.1, 3).shape == (0, 5, 3)


def test_a_centre_is_in_its_own_ball():
    cloud = torch.rand(50, 3, generator=torch.Generator().manual_seed(1)) + 10
    assert torch.equal(ball_query(cloud, cloud, 1e-6, 1).squeeze(-1), torch.arange(50))


def test_group_carries_gradients():
    features = torch.ones(4, 2, requires_grad=True)
    group(features, torch.tensor([[0, 0, 3]])).sum().backward()
    assert features.grad is not None
    assert features.grad[:, 0].tolist() == [2, 0, 0, 1]


def test_gradients_of_group_are_those_of_finite_differences():
    features = torch.rand(2, 6, 3, dtype=torch.float64, requires_grad=True)
    index = torch.tensor([[[0, 1], [5, 5]], [[2, 2], [3, 0]]])
    assert torch.autograd.gradcheck(lambda f: group(f, index), features)


def _sample_and_group(xyz, mask):
    index = farthest_point_sample(xyz, 6, mask=mask, start="outermost")
    centres = xyz.gather(-2, index[..., None].expand(*index.shape, 3))
    return group(xyz, ball_query(xyz, centres, 0.03, 5, mask=mask)) - centres[..., None, :]


def test_vmap_is_a_loop():
    xyz = 0.1 * torch.rand(4, 3, 40, 3, generator=torch.Generator().manual_seed(5))
    mask = torch.rand(4, 3, 40, generator=torch.Generator().manual_seed(6)) < 0.7
    expected = _sample_and_group(xyz, mask)
    assert torch.equal(torch.vmap(_sample_and_group)(xyz, mask), expected)
    mapped = torch.vmap(_sample_and_group, in_dims=(1, None), out_dims=1)
    assert torch.equal(
        mapped(xyz, mask[:, 0]), torch.stack([_sample_and_group(x, mask[:, 0]) for x in xyz.unbind(1)], 1)
    )


def test_compiles_as_one_graph():
    xyz = 0.1 * torch.rand(3, 40, 3, generator=torch.Generator().manual_seed(7))
    mask = torch.rand(3, 40, generator=torch.Generator().manual_seed(8)) < 0.7
    compiled = torch.compile(_sample_and_group, backend="aot_eager", fullgraph=True)
    assert torch.equal(compiled(xyz, mask), _sample_and_group(xyz, mask))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: farthest_point_sample(torch.empty(2, 0, 3), 4), r"\(2, 0, 3\)"),
        (lambda: farthest_point_sample(torch.rand(2, 5, 4), 4), r"\(2, 5, 4\)"),
        (lambda: farthest_point_sample(torch.rand(2, 5, 3), 0), "num=0"),
        (lambda: farthest_point_sample(torch.rand(5, 3), 2, start="last"), "start='last'"),
        (lambda: farthest_point_sample(torch.rand(5, 3), 2, mask=torch.ones(4).bool()), r"mask \(4,\)"),
        (lambda: ball_query(torch.rand(5, 3), torch.rand(2, 2, 3), 0.1, 2), r"centres \(2, 2, 3\)"),
        (lambda: ball_query(torch.rand(5, 3), torch.rand(2, 3), -0.1, 2), "radius=-0.1"),
    ],
)
def test_wrong_input_is_refused(wrong, message):
    with pytest.raises(ConfigError, match=message):
        wrong()
