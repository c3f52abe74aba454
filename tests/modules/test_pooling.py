"""The max over winners alone has the values and gradients of the max over everything."""

import pytest
import torch
from torch import nn

from torchgrasp.modules import PointNet2, pooling
from torchgrasp.modules.layers import mlp
from torchgrasp.modules.pooling import max_over_neighbours, max_over_rows


def _gradients(layers, inputs, output):
    (output * torch.linspace(-1, 2, output.numel()).view_as(output)).sum().backward()
    found = [p.grad.clone() for p in (*layers.parameters(), *inputs)]
    layers.zero_grad()
    for tensor in inputs:
        tensor.grad = None
    return found


@pytest.mark.parametrize("norm", ["none", "layer"])
@pytest.mark.parametrize("groups", [1, 90])  # 90 groups of 50 rows span several chunks
def test_rows(norm, groups):
    torch.manual_seed(0)
    layers = mlp((5, 16, 24), norm=norm, last_activation=False).double()
    rows = torch.randn(groups, 50, 5, dtype=torch.float64, requires_grad=True)
    expected = layers(rows).amax(dim=1)
    dense = _gradients(layers, [rows], expected)
    found = max_over_rows(layers, rows)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(_gradients(layers, [rows], found), dense)


def test_a_row_for_each_channel():
    """What CUDA devices do with long groups: 50 rows, of which each of 20 channels keeps its winner."""
    torch.manual_seed(0)
    layers = mlp((5, 16, 20), norm="layer", last_activation=True).double()
    rows = torch.randn(3, 50, 5, dtype=torch.float64, requires_grad=True)
    expected = layers(rows).amax(dim=1)
    dense = _gradients(layers, [rows], expected)
    found = pooling._max_over_winners(layers, rows)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(_gradients(layers, [rows], found), dense)


def test_which_networks_one_kernel_holds():
    stages = PointNet2(4, width=0.1).abstractions
    assert [len(pooling._linear_layers(stage.rest)) for stage in stages] == [2, 2]
    assert not pooling._linear_layers(PointNet2(4, width=0.1, norm="layer").abstractions[0].rest)
    assert not pooling._linear_layers(nn.Sequential(nn.ReLU(), nn.Linear(3, 4)))
    assert not pooling._linear_layers(nn.Sequential(nn.ReLU(), nn.Linear(3, 4), nn.Tanh()))
    assert not pooling._linear_layers(nn.Sequential(nn.ReLU(), nn.Linear(3, 4, bias=False), nn.ReLU()))


def test_neighbours():
    torch.manual_seed(0)
    layers = nn.Sequential(nn.ReLU(), *mlp((4, 8, 16))).double()
    points = torch.randn(3, 20, 4, dtype=torch.float64, requires_grad=True)
    centres = torch.randn(3, 7, 4, dtype=torch.float64, requires_grad=True)
    index = torch.randint(0, 20, (3, 7, 5))
    rows = torch.stack([p[i] for p, i in zip(points, index, strict=True)]) - centres[:, :, None]
    expected = layers(rows).amax(dim=2)
    dense = _gradients(layers, [points, centres], expected)
    found = max_over_neighbours(layers, points, centres, index)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(_gradients(layers, [points, centres], found), dense)


def test_no_graph_where_nothing_is_trained():
    layers = mlp((3, 4)).requires_grad_(False)
    assert not max_over_rows(layers, torch.rand(2, 3, 3)).requires_grad
    rows = torch.rand(2, 3, 3, requires_grad=True)
    assert max_over_rows(layers, rows).requires_grad
