"""A network of rows and its max over each ball, as one torch operator for CUDA devices."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor
from torch.utils._pytree import tree_flatten, tree_map, tree_unflatten

from torchgrasp.ops.cuda import succeeds


def serves(points: Tensor) -> bool:
    """Whether `ball_max` takes these points: on a CUDA device where it works, and no float64."""
    return points.is_cuda and points.dtype != torch.float64 and _works_on(points.device)


def ball_max(
    points: Tensor,
    centres: Tensor,
    index: Tensor,
    weights: Sequence[Tensor],
    biases: Sequence[Tensor],
    dtype: torch.dtype,
    *,
    exact: bool = False,
) -> Tensor:
    """Max over K of a network of ``points[index] - centres``: (B, M, F), of type `dtype`.

    The network is ReLU, linear, ReLU, ..., linear, ReLU. Places that repeat a ball's first neighbour cost
    nothing where they come last, as `ops.ball_query` fills them. At least one ball, and no vmap.

    Args:
        points: (B, N, C).
        centres: (B, M, C).
        index: (B, M, K) int64, into the N points.
        weights: (C', C) of each linear layer.
        biases: (C') of each.
        dtype: of the factors of products; sums are float32. float32 is multiplied at its full precision,
            unless torch.backends.cuda.matmul.fp32_precision says 'tf32'.
        exact: multiply it so whatever that says.
    """
    points, centres, index = points.contiguous(), centres.contiguous(), index.contiguous()
    weights = [weight.contiguous() for weight in weights]
    values = _ball_max_op(points, centres, index, weights, list(biases), dtype, exact)[0]
    return values.unflatten(0, index.shape[:2])


def dense_ball_max(
    points: Tensor, centres: Tensor, index: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor]
) -> Tensor:
    """`ball_max` as its definition says."""
    rows = torch.stack([cloud[i] for cloud, i in zip(points, index, strict=True)]) - centres[:, :, None]
    for weight, bias in zip(weights, biases, strict=True):
        rows = torch.nn.functional.linear(rows.relu(), weight, bias)
    return rows.relu().amax(dim=2)


@torch.library.custom_op("torchgrasp::ball_max", mutates_args=())
def _ball_max_op(
    points: Tensor,
    centres: Tensor,
    index: Tensor,
    weights: list[Tensor],
    biases: list[Tensor],
    dtype: torch.dtype,
    exact: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, list[Tensor]]:
    from torchgrasp.ops import row_passes

    values, winner, rows, hidden = row_passes.forward(
        *(points, centres, index, weights, biases, dtype), exact=exact
    )
    return values, winner, rows.owner, rows.neighbour, rows.ends, hidden


@torch.library.custom_op("torchgrasp::ball_max_backward", mutates_args=())
def _backward_op(
    grad: Tensor,
    winner: Tensor,
    owner: Tensor,
    neighbour: Tensor,
    ends: Tensor,
    points: Tensor,
    centres: Tensor,
    hidden: list[Tensor],
    weights: list[Tensor],
    trains: bool,
    exact: bool,
) -> tuple[Tensor, Tensor, list[Tensor], list[Tensor]]:
    from torchgrasp.ops import row_passes

    rows = row_passes.Rows(owner, neighbour, ends)
    return row_passes.backward(
        grad, winner, rows, points, centres, hidden, weights, trains=trains, exact=exact
    )


@_ball_max_op.register_fake
def _(points, centres, index, weights, biases, dtype, exact):
    groups, places, channels = centres.shape[0] * centres.shape[1], index.numel(), len(weights[-1])
    whole = {"dtype": torch.int32}
    return (
        points.new_empty((groups, channels), dtype=dtype),
        points.new_empty((groups, channels), **whole),
        points.new_empty(places, **whole),
        points.new_empty(places, **whole),
        points.new_empty(groups, **whole),
        [points.new_empty((places, len(weight)), dtype=dtype) for weight in weights[:-1]],
    )


@_backward_op.register_fake
def _(grad, winner, owner, neighbour, ends, points, centres, hidden, weights, trains, exact):
    of_weights = [torch.empty_like(w, dtype=torch.float32) for w in weights if trains]
    of_biases = [w.new_empty(len(w), dtype=torch.float32) for w in weights if trains]
    return (
        torch.empty_like(points, dtype=torch.float32),
        torch.empty_like(centres, dtype=torch.float32),
        of_weights,
        of_biases,
    )


@_ball_max_op.register_vmap
def _(info, in_dims, *arguments):
    leaves, spec = tree_flatten(arguments)
    dims = tree_flatten(in_dims, is_leaf=lambda dim: dim is None)[0]
    results = []
    for i in range(info.batch_size):
        slices = [x if d is None else x.select(d, i).contiguous() for x, d in zip(leaves, dims, strict=True)]
        results.append(_ball_max_op(*tree_unflatten(slices, spec)))
    stacked = tree_map(lambda *slices: torch.stack(slices), *results)
    return stacked, tree_map(lambda _: 0, stacked)


def _keep(ctx, inputs, output) -> None:
    points, centres, _, weights, biases, _, ctx.exact = inputs
    _, winner, owner, neighbour, ends, hidden = output
    ctx.set_materialize_grads(False)
    ctx.layers = len(weights)
    ctx.trains = any(tensor.requires_grad for tensor in (*weights, *biases))
    ctx.types = [tensor.dtype for tensor in biases]
    ctx.save_for_backward(winner, owner, neighbour, ends, points, centres, *hidden, *weights)


def _differentiate(ctx, grad, *_):
    winner, owner, neighbour, ends, points, centres, *rest = ctx.saved_tensors
    hidden, weights = rest[: ctx.layers - 1], rest[ctx.layers - 1 :]
    of_points, of_centres, of_weights, of_biases = _backward_op(
        *(grad.contiguous(), winner, owner, neighbour, ends, points, centres, hidden, weights),
        *(ctx.trains, ctx.exact),
    )
    none = [None] * ctx.layers
    return (
        of_points.to(points.dtype),
        of_centres.to(centres.dtype),
        None,
        [g.to(w.dtype) for g, w in zip(of_weights, weights, strict=True)] if ctx.trains else none,
        [g.to(t) for g, t in zip(of_biases, ctx.types, strict=True)] if ctx.trains else none,
        None,
        None,
    )


_ball_max_op.register_autograd(_differentiate, setup_context=_keep)


@torch.compiler.assume_constant_result
def _works_on(device: torch.device) -> bool:
    return _tried(device)


@functools.cache
def _tried(device: torch.device) -> bool:
    """Whether values and gradients of a small problem on this device are those of the definition."""
    check = functools.partial(check_against_dense, device)
    instead = "slower torch operations, which take more memory,"
    return succeeds(check, "kernels of a network over balls", device, instead=instead)


def check_against_dense(device: torch.device) -> None:
    """Raise ValueError where `ball_max` or a gradient of it differs from its definition."""
    generator = torch.Generator().manual_seed(0)
    widths = (20, 24, 40)
    shapes = [(2, 20, 20), (2, 3, 20)]
    shapes += [(above, below) for below, above in pairwise(widths)]
    shapes += [(above,) for above in widths[1:]]
    index = torch.randint(0, 20, (2, 3, 30), generator=generator).to(device)
    index[:, :2, 7:] = index[:, :2, :1]
    with torch.enable_grad(), torch.autocast(device.type, enabled=False):
        tensors = [torch.randn(shape, generator=generator).to(device).requires_grad_() for shape in shapes]
        exact = [tensor.double() for tensor in tensors]
        points, centres, *layers = tensors
        found = ball_max(points, centres, index, layers[:2], layers[2:], torch.float32, exact=True)
        points, centres, *layers = exact
        expected = dense_ball_max(points, centres, index, layers[:2], layers[2:])
        factors = torch.linspace(-1, 2, found.numel(), device=device).view_as(found)
        pairs = zip(
            (found, *torch.autograd.grad((found * factors).sum(), tensors)),
            (expected, *torch.autograd.grad((expected * factors).sum(), tensors)),
            strict=True,
        )
        if not all(torch.allclose(a.double(), b.double(), rtol=1e-4, atol=1e-4) for a, b in pairs):
            raise ValueError("they find other values or gradients")
