# pyright: reportCallIssue=false, reportArgumentType=false
"""Passes of a network over the rows of balls, forward and backward: where `row_kernels` are launched.

Rows are the places of a ball that hold different points. They stand one behind the other, whatever ball they
are of. How many there are stays on the device, so that nothing waits for it: tensors have room for all
places, and what lies behind the last row is never written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
import triton
import triton.language as tl
from torch import Tensor

from torchgrasp.ops import row_kernels
from torchgrasp.ops.kernels import on_device_of

# Of a product's tile: rows, channels at most, and how many channels it sums at a time. So a tile of float32
# fits into registers, and into the shared memory of any GPU since Ampere.
_ROWS = 64
_CHANNELS = 128
_SUMMED_CHANNELS = 32
_LAUNCH = {"num_warps": 8, "num_stages": 2}
# Of a gradient of weights: channels of a tile, rows that it sums at a time, programs that share it, about.
_WEIGHT_CHANNELS = 64
_SUMMED_ROWS = 32
_PROGRAMS = 512
# Rows of a ball that its max and its sum read at a time.
_BALL_ROWS = 16

_TYPES = {torch.float32: tl.float32, torch.bfloat16: tl.bfloat16, torch.float16: tl.float16}


class Rows(NamedTuple):
    """The R rows of G balls, int32."""

    owner: Tensor  # (G K) the ball of each row
    neighbour: Tensor  # (G K) its point, counted through all clouds
    ends: Tensor  # (G) one past the last row of each ball: the last is R


@dataclass(frozen=True)
class _Layer:
    """One linear layer of a pass: ``relu(x) W^T + b``; x is points - centres where there are centres."""

    x: Tensor
    centres: Tensor | None
    rows: Rows
    weight: Tensor
    dtype: torch.dtype
    precision: str

    def inputs(self) -> tuple[Any, ...]:
        centres = self.x if self.centres is None else self.centres
        return (self.x, centres, *self.rows, len(self.rows.ends))

    def sizes(self, below: int, above: int) -> tuple[dict[str, Any], int, int]:
        """What kernels are specialised on, with tiles of at most so many channels, and how many tiles."""
        c_out, c_in = self.weight.shape
        options = {
            "GATHER": self.centres is not None,
            "PRECISION": self.precision,
            "TYPE": _TYPES[self.dtype],
            "IN": _block(c_in, below),
            "OUT": _block(c_out, above),
            **_LAUNCH,
        }
        return options, triton.cdiv(c_in, options["IN"]), triton.cdiv(c_out, options["OUT"])


def forward(
    points: Tensor,
    centres: Tensor,
    index: Tensor,
    weights: Sequence[Tensor],
    biases: Sequence[Tensor],
    dtype: torch.dtype,
    *,
    exact: bool,
) -> tuple[Tensor, Tensor, Rows, list[Tensor]]:
    """The (G, F) max over each ball, the rows that attain it, all rows, and the inputs of the later layers.

    Arguments are contiguous, and as for `ball_max`.
    """
    rows = _list_rows(index, points.shape[1])
    x, origin, hidden = points, centres, []
    for weight, bias in zip(weights, biases, strict=True):
        x = _linear(_Layer(x, origin, rows, weight, dtype, _precision(exact)), bias)
        origin = None
        hidden.append(x)
    values, winner = _pool(x, rows)
    return values, winner, rows, hidden[:-1]


def backward(
    grad: Tensor,
    winner: Tensor,
    rows: Rows,
    points: Tensor,
    centres: Tensor,
    hidden: Sequence[Tensor],
    weights: Sequence[Tensor],
    *,
    trains: bool,
    exact: bool,
) -> tuple[Tensor, Tensor, list[Tensor], list[Tensor]]:
    """Gradients, float32, of points, centres, weights and biases; none of the last two unless it `trains`."""
    layers = [
        _Layer(x, centres if i == 0 else None, rows, weight, grad.dtype, _precision(exact))
        for i, (x, weight) in enumerate(zip((points, *hidden), weights, strict=True))
    ]
    of_weights, of_biases, wins = [], [], winner
    for layer in reversed(layers):
        if trains:
            of_weight, of_bias = _weight_gradient(layer, grad, wins)
            of_weights.insert(0, of_weight)
            of_biases.insert(0, of_bias)
        grad, wins = _input_gradient(layer, grad, wins), None
    return *_scatter(grad, rows, points, centres), of_weights, of_biases


def _precision(exact: bool) -> str:
    """How float32 is multiplied: three products of TF32 are as good as float32, and use tensor cores."""
    return "tf32" if not exact and torch.backends.cuda.matmul.fp32_precision == "tf32" else "tf32x3"


def _block(channels: int, limit: int) -> int:
    return min(limit, max(16, triton.next_power_of_2(channels)))


def _list_rows(index: Tensor, num_points: int) -> Rows:
    """The rows of (B, M, K) indices into clouds of `num_points`: places that repeat the first are none."""
    clouds, num_centres, num = index.shape
    counts = torch.empty(clouds * num_centres, dtype=torch.int32, device=index.device)
    owner = torch.empty(index.numel(), dtype=torch.int32, device=index.device)
    neighbour, grid = torch.empty_like(owner), (len(counts),)
    options = {"BLOCK": triton.next_power_of_2(num), "num_warps": 1}
    with on_device_of(index):
        row_kernels.count[grid](index, counts, num, **options)
        ends = counts.cumsum(0, dtype=torch.int32)
        row_kernels.list_rows[grid](*(index, ends, owner, neighbour, num, num_points, num_centres), **options)
    return Rows(owner, neighbour, ends)


def _linear(layer: _Layer, bias: Tensor) -> Tensor:
    c_out, c_in = layer.weight.shape
    room = len(layer.rows.owner)
    out = torch.empty((room, c_out), dtype=layer.dtype, device=bias.device)
    options, _, blocks = layer.sizes(_SUMMED_CHANNELS, _CHANNELS)
    with on_device_of(bias):
        row_kernels.linear[(triton.cdiv(room, _ROWS), blocks)](
            *layer.inputs(), *(layer.weight, bias, out, c_in, c_out), ROWS=_ROWS, **options
        )
    return out


def _pool(x: Tensor, rows: Rows) -> tuple[Tensor, Tensor]:
    """(G, F) largest relu(x) of each ball, and the (G, F) row that has it, -1 where it is 0."""
    groups, channels = len(rows.ends), x.shape[1]
    values = x.new_empty((groups, channels))
    winner = x.new_empty((groups, channels), dtype=torch.int32)
    block = _block(channels, _CHANNELS)
    with on_device_of(x):
        row_kernels.pool[(groups, triton.cdiv(channels, block))](
            *(x, rows.ends, values, winner, channels), ROWS=_BALL_ROWS, CHANNELS=block
        )
    return values, winner


def _input_gradient(layer: _Layer, grad: Tensor, winner: Tensor | None) -> Tensor:
    """The gradient of x; `grad` is that of the layer's result, or of the max where there are winners."""
    c_out, c_in = layer.weight.shape
    room = len(layer.rows.owner)
    out = grad.new_empty((room, c_in))
    options, blocks, _ = layer.sizes(_CHANNELS, _SUMMED_CHANNELS)
    with on_device_of(grad):
        row_kernels.input_gradient[(triton.cdiv(room, _ROWS), blocks)](
            *(grad, grad if winner is None else winner, *layer.inputs()),
            *(layer.weight, out, c_in, c_out),
            SPARSE=winner is not None,
            ROWS=_ROWS,
            **options,
        )
    return out


def _weight_gradient(layer: _Layer, grad: Tensor, winner: Tensor | None) -> tuple[Tensor, Tensor]:
    """The gradients of weight and bias, as sums of what each of many programs finds."""
    c_out, c_in = layer.weight.shape
    options, blocks_in, blocks_out = layer.sizes(_WEIGHT_CHANNELS, _WEIGHT_CHANNELS)
    shares = max(1, _PROGRAMS // (blocks_in * blocks_out))
    weights = grad.new_empty((shares, c_out, c_in), dtype=torch.float32)
    biases = grad.new_empty((shares, c_out), dtype=torch.float32)
    with on_device_of(grad):
        row_kernels.weight_gradient[(shares, blocks_out, blocks_in)](
            *(grad, grad if winner is None else winner, *layer.inputs()),
            *(weights, biases, c_in, c_out, shares),
            SPARSE=winner is not None,
            ROWS=_SUMMED_ROWS,
            **options,
        )
    return weights.sum(dim=0), biases.sum(dim=0)


def _scatter(grad: Tensor, rows: Rows, points: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
    """The gradients of points and centres from those of rows."""
    groups, channels = len(rows.ends), grad.shape[1]
    of_points = torch.zeros_like(points, dtype=torch.float32)
    of_centres = torch.empty_like(centres, dtype=torch.float32)
    block = _block(channels, _CHANNELS)
    with on_device_of(grad):
        row_kernels.scatter[(groups, triton.cdiv(channels, block))](
            *(grad, rows.neighbour, rows.ends, of_points, of_centres, channels),
            ROWS=_BALL_ROWS,
            CHANNELS=block,
        )
    return of_points, of_centres
