"""Run as a script with TRITON_INTERPRET=1: the Triton kernels, interpreted, against the definitions."""

import torch

from torchgrasp.ops import definitions, dense, kernels
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


if __name__ == "__main__":
    for size in SIZES:
        for dtype in (torch.float32, torch.bfloat16):
            check(*size, dtype)
    check_against_dense(kernels, torch.device("cpu"))
    print("agree")
