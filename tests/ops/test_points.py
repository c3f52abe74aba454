"""The fast point operations against their definitions, on clouds that provoke ties."""

import pytest
import torch

from torchgrasp.errors import ConfigError
from torchgrasp.ops import ball_query, farthest_point_sample, group, reference

CLOUDS = {
    "random": lambda g: torch.rand(3, 40, 3, generator=g) * 0.1,
    "duplicates": lambda g: torch.rand(3, 10, 3, generator=g).repeat(1, 4, 1) * 0.1,
    "grid": lambda g: torch.randint(0, 3, (3, 40, 3), generator=g) * 0.02,
    "one point": lambda g: torch.full((3, 40, 3), 0.3),
    "single": lambda g: torch.rand(3, 1, 3, generator=g),
}


@pytest.fixture(params=CLOUDS)
def clouds(request):
    return CLOUDS[request.param](torch.Generator().manual_seed(0))


@pytest.mark.parametrize("num", [1, 8, 48])
def test_sampling_equals_its_definition(clouds, num):
    expected = torch.stack([reference.farthest_point_sample(cloud, num) for cloud in clouds])
    assert torch.equal(farthest_point_sample(clouds, num), expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("radius", "num"), [(0.02, 4), (0.04, 64), (1.0, 16)])
def test_ball_query_equals_its_definition(clouds, radius, num, dtype):
    clouds = clouds.to(dtype)
    centres = clouds[:, :5] + torch.tensor([0.0, 0.01, 0.0], dtype=dtype)
    expected = torch.stack(
        [reference.ball_query(p, c, radius, num) for p, c in zip(clouds, centres, strict=True)]
    )
    assert torch.equal(ball_query(clouds, centres, radius, num), expected)


def test_group_equals_its_definition(clouds):
    features = torch.cat((clouds, clouds.square()), dim=-1)
    index = ball_query(clouds, clouds[:, :5], 0.05, 6)
    expected = torch.stack([reference.group(f, i) for f, i in zip(features, index, strict=True)])
    assert torch.equal(group(features, index), expected)


def test_any_leading_dimensions(clouds):
    nested = clouds[None, :, None].expand(2, 3, 2, *clouds.shape[-2:])
    index = farthest_point_sample(nested, 4)
    assert index.shape == (2, 3, 2, 4)
    assert torch.equal(index[1, :, 1], farthest_point_sample(clouds, 4))
    assert torch.equal(farthest_point_sample(clouds[0], 4), index[0, 0, 0])
    neighbours = ball_query(nested, nested[..., :1, :], 0.05, 3)
    assert torch.equal(neighbours[1, :, 1], ball_query(clouds, clouds[:, :1], 0.05, 3))


def test_a_centre_is_in_its_own_ball():
    cloud = torch.rand(50, 3, generator=torch.Generator().manual_seed(1)) + 10
    assert torch.equal(ball_query(cloud, cloud, 1e-6, 1).squeeze(-1), torch.arange(50))


def test_group_carries_gradients():
    features = torch.ones(4, 2, requires_grad=True)
    group(features, torch.tensor([[0, 0, 3]])).sum().backward()
    assert features.grad is not None
    assert features.grad[:, 0].tolist() == [2, 0, 0, 1]


def test_sampling_from_nothing_is_an_error():
    with pytest.raises(ConfigError, match="0 points"):
        farthest_point_sample(torch.empty(2, 0, 3), 4)
