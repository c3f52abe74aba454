"""The operations of `definitions` for batches, as torch operators: one kernel a device, the same results.

They are custom operators, so that torch.compile and vmap take each as a whole. On the CPU, and where
Triton does not work, `dense` computes them; on a CUDA device the kernels of `kernels` do.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.ops import dense
from torchgrasp.ops.cuda import cuda_kernels

Start = Literal["first", "outermost", "random"]


def farthest_point_sample(
    xyz: Tensor,
    num: int,
    *,
    mask: Tensor | None = None,
    start: Start = "first",
    generator: torch.Generator | None = None,
) -> Tensor:
    """(*, N, 3) points, metres, to (*, num) int64 indices, each the farthest from all before it.

    Ties go to the lower index; once every point coincides with a chosen one, the point of the lowest
    index repeats. Distances are computed in float32 at least. No gradient passes.

    Args:
        xyz: the clouds; float32, float64, float16 or bfloat16.
        num: how many to choose.
        mask: (*, N) bool: which rows are points; the others are padding and never chosen. A cloud
            without points gives index 0 throughout.
        start: the point chosen first: 'first', of the lowest index; 'outermost', the farthest from the
            centre of the cloud's bounding box, which does not depend on the points' order; 'random'.
        generator: of the random start; torch's own without one.

    Example:
        >>> line = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 0, 0]])
        >>> farthest_point_sample(line, 3)
        tensor([0, 3, 2])
        >>> farthest_point_sample(line, 2, mask=torch.tensor([False, True, True, True]))
        tensor([1, 3])
    """
    _check_cloud(xyz, mask)
    check_whole("num", num, 1)
    check_start(start)
    with torch.no_grad():
        xyz = _clear_padding(xyz, mask)
        return _farthest_op(xyz, _first(xyz, mask, start, generator), mask, num)


def ball_query(
    xyz: Tensor, centres: Tensor, radius: float, num: int, *, mask: Tensor | None = None
) -> Tensor:
    """(*, N, 3) points and (*, M, 3) centres, metres, to (*, M, num) int64 indices of neighbours.

    Neighbours are the `num` nearest points at most `radius` metres away, nearest first, ties to the
    lower index. Where fewer are in the ball, the nearest point of all fills the remaining places,
    even from outside the ball: a centre that is one of the points is always in its own ball.
    Distances are computed in float32 at least. No gradient passes.

    Args:
        xyz: the clouds; float32, float64, float16 or bfloat16.
        centres: of the balls, of the clouds' type.
        radius: metres.
        num: places a ball.
        mask: (*, N) bool: which rows are points; the others are nobody's neighbour. A cloud without
            points gives index 0 throughout.

    Example:
        >>> line = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 0, 0]])
        >>> ball_query(line, line[[1, 3]], radius=1.0, num=4)
        tensor([[1, 0, 2, 1],
                [3, 3, 3, 3]])
    """
    _check_cloud(xyz, mask)
    check_whole("num", num, 1)
    check_range("radius", radius, 0.0, float("inf"))
    if centres.shape[-1] != 3 or centres.shape[:-2] != xyz.shape[:-2] or centres.dtype != xyz.dtype:
        raise ConfigError(
            f"centres {tuple(centres.shape)} {centres.dtype} do not go with points {tuple(xyz.shape)} "
            f"{xyz.dtype}: give (*, M, 3) of the same leading dimensions and type."
        )
    with torch.no_grad():
        return _ball_op(_clear_padding(xyz, mask), centres.detach(), mask, float(radius), num)


def group(features: Tensor, index: Tensor) -> Tensor:
    """(*, N, C) features and (*, M, K) indices to the (*, M, K, C) features that they name.

    Gradients pass to the features.

    Example:
        >>> group(torch.tensor([[5.0], [6.0]]), torch.tensor([[1, 0], [1, 1]])).squeeze(-1)
        tensor([[6., 5.],
                [6., 6.]])
    """
    channels = features.shape[-1]
    flat = index.flatten(-2)[..., None].expand(*index.shape[:-2], -1, channels)
    return features.gather(-2, flat).unflatten(-2, index.shape[-2:])


def check_start(start: Start) -> None:
    """Raise ConfigError for an unknown way to begin."""
    if start not in ("first", "outermost", "random"):
        raise ConfigError(f"start={start!r} is unknown: choose 'first', 'outermost' or 'random'.")


def _check_cloud(xyz: Tensor, mask: Tensor | None) -> None:
    if xyz.ndim < 2 or xyz.shape[-1] != 3 or xyz.shape[-2] == 0 or not xyz.is_floating_point():
        raise ConfigError(
            f"points of shape {tuple(xyz.shape)} and type {xyz.dtype}: give (*, N, 3) numbers, N at least 1."
        )
    if mask is not None and (mask.dtype != torch.bool or mask.shape != xyz.shape[:-1]):
        raise ConfigError(
            f"mask {tuple(mask.shape)} {mask.dtype}: give bool of shape {tuple(xyz.shape[:-1])}."
        )


def _clear_padding(xyz: Tensor, mask: Tensor | None) -> Tensor:
    """The points, and zeros for padding, which may hold NaN."""
    return xyz.detach() if mask is None else torch.where(mask[..., None], xyz.detach(), 0.0)


def _first(
    xyz: Tensor, mask: Tensor | None, start: Start, generator: torch.Generator | None
) -> Tensor | None:
    """(*) int64: the index that sampling begins with; None for the outermost, which the operator finds."""
    if start == "outermost":
        return None
    if start == "first":
        rank = -torch.arange(xyz.shape[-2], device=xyz.device).expand(xyz.shape[:-1])
    else:
        rank = torch.rand(xyz.shape[:-1], generator=generator, device=xyz.device)
    # Padding ranks below every point; of equals argmax takes the first.
    rank = rank if mask is None else rank.masked_fill(~mask, -xyz.shape[-2])
    return rank.argmax(dim=-1)


@torch.library.custom_op("torchgrasp::farthest_point_sample", mutates_args=())
def _farthest_op(xyz: Tensor, first: Tensor | None, mask: Tensor | None, num: int) -> Tensor:
    kernels = cuda_kernels(xyz) or dense
    return kernels.farthest_point_sample(xyz, first, mask, num)


@torch.library.custom_op("torchgrasp::ball_query", mutates_args=())
def _ball_op(xyz: Tensor, centres: Tensor, mask: Tensor | None, radius: float, num: int) -> Tensor:
    kernels = cuda_kernels(xyz) or dense
    return kernels.ball_query(xyz, centres, mask, radius, num)


@_farthest_op.register_fake
def _(xyz: Tensor, first: Tensor | None, mask: Tensor | None, num: int) -> Tensor:
    return xyz.new_empty((*xyz.shape[:-2], num), dtype=torch.int64)


@_ball_op.register_fake
def _(xyz: Tensor, centres: Tensor, mask: Tensor | None, radius: float, num: int) -> Tensor:
    return centres.new_empty((*centres.shape[:-1], num), dtype=torch.int64)


@_farthest_op.register_vmap
def _(info, in_dims, xyz, first, mask, num):
    tensors = _stack_first(info.batch_size, in_dims, xyz, first, mask)
    return _farthest_op(*tensors, num), 0


@_ball_op.register_vmap
def _(info, in_dims, xyz, centres, mask, radius, num):
    tensors = _stack_first(info.batch_size, in_dims, xyz, centres, mask)
    return _ball_op(*tensors, radius, num), 0


def _stack_first(size: int, dims: tuple, *tensors: Tensor | None) -> list:
    """The tensors with the mapped dimension in front: the operators take any leading dimensions."""
    pairs = zip(tensors, dims, strict=False)
    return [t if t is None else t.expand(size, *t.shape) if d is None else t.movedim(d, 0) for t, d in pairs]
