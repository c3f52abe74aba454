"""Run as a script with TRITON_INTERPRET=1: the Triton kernels, interpreted, against the definitions."""

import torch

from torchgrasp.ops import ball_max, definitions, dense, kernels, row_passes
from torchgrasp.ops.cuda import check_against_dense

SIZES = ((1, 1), (33, 5), (130, 16))


def check(num_points: int, num: int, dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(num_points)
    xyz = torch.randint(0, 6, (2, num_points, 3), generator=generator).to(dtype) * 0.0123
    xyz[1] = 0.1 * torch.rand(num_points, 3, generator=generator)
    mask = torch.rand(2, num_points, generator=generator) < 0.7
    for valid in (None, mask):
        first = dense.outermost_point(xyz, valid)
        index = kernels.farthest_point_sample(xyz, first, valid, num)
        centres = xyz.gather(1, index[:, :3, None].expand(-1, -1, 3))
        found = kernels.ball_query(xyz, centres, valid, 0.03, num)
        for b in range(2):
            one = None if valid is None else valid[b]
            expected = definitions.farthest_point_sample(xyz[b], num, int(first[b]), one)
            assert torch.equal(index[b], expected), (num_points, dtype, "farthest")
            expected = definitions.ball_query(xyz[b], centres[b], 0.03, num, one)
            assert torch.equal(found[b], expected), (num_points, dtype, "ball")


def check_network() -> None:
    """Widths that fill no tile, places of no row, NaN, vmap. The interpreter has no products of bfloat16."""
    row_passes._PROGRAMS = 3
    ball_max.check_against_dense(torch.device("cpu"))
    generator = torch.Generator().manual_seed(0)
    points, centres = (torch.randn(2, n, 33, generator=generator).requires_grad_() for n in (9, 4))
    layer = torch.randn(130, 33, generator=generator), torch.randn(130, generator=generator)
    index = torch.randint(0, 9, (2, 4, 7), generator=generator)
    index[0, 1:, 1:] = index[0, 1:, :1]
    arguments = (points, centres, index, layer[:1], layer[1:])
    expected = ball_max.dense_ball_max(*arguments)
    low = ball_max.ball_max(*arguments, torch.float16)
    torch.testing.assert_close(low, expected.half(), rtol=0.02, atol=0.02)
    gradients = (torch.autograd.grad(values.float().sum(), (points, centres)) for values in (low, expected))
    for found, wanted in zip(*gradients, strict=True):
        assert (found - wanted).norm() < 0.05 * wanted.norm()
    mapped = torch.vmap(lambda p, c, i: ball_max.ball_max(p[None], c[None], i[None], *arguments[3:], p.dtype))
    torch.testing.assert_close(mapped(*arguments[:3])[:, 0], expected)
    points.data[1, index[1, 2, 3]] = torch.nan
    assert ball_max.ball_max(*arguments, torch.float32)[1, 2].isnan().all()


if __name__ == "__main__":
    for size in SIZES:
        for dtype in (torch.float32, torch.bfloat16):
            check(*size, dtype)
    check_against_dense(kernels, torch.device("cpu"))
    check_network()
    print("agree")
