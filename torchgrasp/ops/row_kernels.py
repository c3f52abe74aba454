# pyright: reportCallIssue=false, reportOperatorIssue=false, reportArgumentType=false
"""Triton kernels of a network of rows and its max over each ball; `row_passes` launches them.

A layer is one kernel forward and two backward. The first layer reads ``points[neighbour] - centre`` where it
needs them (GATHER), and the gradient of the max, one row a channel, is made where it is needed (SPARSE):
neither is ever written. A program behind the last row returns at once.
"""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def count(index, counts, num, BLOCK: tl.constexpr):
    """How many places of each ball (one a program) are rows: up to the last that differs from the first."""
    at = index + tl.program_id(0).to(tl.int64) * num
    place = tl.arange(0, BLOCK)
    inside = place < num
    differs = tl.load(at + place, mask=inside, other=0) != tl.load(at)
    tl.store(counts + tl.program_id(0), 1 + tl.max(tl.where(inside & differs, place, 0), axis=0))


@triton.jit
def list_rows(index, ends, owner, neighbour, num, num_points, num_centres, BLOCK: tl.constexpr):
    """Owner and neighbour of the rows of each ball, one a program, from where the ball before it ends."""
    ball = tl.program_id(0)
    place = tl.arange(0, BLOCK)
    begin = tl.load(ends + ball - 1, mask=ball > 0, other=0)
    inside = place < tl.load(ends + ball) - begin
    point = tl.load(index + ball.to(tl.int64) * num + place, mask=inside, other=0)
    point += ball // num_centres * num_points
    tl.store(owner + begin + place, ball, mask=inside)
    tl.store(neighbour + begin + place, point.to(tl.int32), mask=inside)


@triton.jit
def _inputs(x, centres, owner, neighbour, row, valid, channel, width, GATHER: tl.constexpr):
    """What enters a layer before its activation, float32; `row` and `channel` broadcast to the tile."""
    inside = valid & (channel < width)
    if GATHER:
        point = tl.load(neighbour + row, mask=valid, other=0).to(tl.int64)
        centre = tl.load(owner + row, mask=valid, other=0).to(tl.int64)
        tile = tl.load(x + point * width + channel, mask=inside, other=0.0).to(tl.float32)
        tile -= tl.load(centres + centre * width + channel, mask=inside, other=0.0).to(tl.float32)
    else:
        tile = tl.load(x + row.to(tl.int64) * width + channel, mask=inside, other=0.0).to(tl.float32)
    return tile


@triton.jit
def _relu(x):
    return tl.where(x < 0.0, 0.0, x)  # NaN stays


@triton.jit
def _gradients(grad, winner, owner, row, valid, channel, width, SPARSE: tl.constexpr):
    """The gradient of what leaves a layer; `row` and `channel` broadcast to the tile."""
    inside = valid & (channel < width)
    if SPARSE:
        at = tl.load(owner + row, mask=valid, other=0).to(tl.int64) * width + channel
        inside = inside & (tl.load(winner + at, mask=inside, other=-1) == row)
        tile = tl.load(grad + at, mask=inside, other=0.0)
    else:
        tile = tl.load(grad + row.to(tl.int64) * width + channel, mask=inside, other=0.0)
    return tile


@triton.jit
def linear(
    x,
    centres,
    owner,
    neighbour,
    ends,
    groups,
    weight,
    bias,
    out,
    c_in,
    c_out,
    GATHER: tl.constexpr,
    PRECISION: tl.constexpr,
    TYPE: tl.constexpr,
    ROWS: tl.constexpr,
    IN: tl.constexpr,
    OUT: tl.constexpr,
):
    """``out = relu(x) W^T + b``: a tile of rows and channels a program."""
    total = tl.load(ends + groups - 1)
    if tl.program_id(0) * ROWS < total:
        row = (tl.program_id(0) * ROWS + tl.arange(0, ROWS))[:, None]
        above = tl.program_id(1) * OUT + tl.arange(0, OUT)
        result = tl.zeros((ROWS, OUT), dtype=tl.float32)
        for start in range(0, c_in, IN):
            below = start + tl.arange(0, IN)
            tile = _inputs(x, centres, owner, neighbour, row, row < total, below[None, :], c_in, GATHER)
            inside = (below[:, None] < c_in) & (above[None, :] < c_out)
            factor = tl.load(weight + above[None, :] * c_in + below[:, None], mask=inside, other=0.0)
            result = tl.dot(_relu(tile).to(TYPE), factor.to(TYPE), result, input_precision=PRECISION)
        result += tl.load(bias + above, mask=above < c_out, other=0.0).to(tl.float32)[None, :]
        at = out + row.to(tl.int64) * c_out + above[None, :]
        tl.store(at, result.to(TYPE), mask=(row < total) & (above[None, :] < c_out))


@triton.jit
def pool(x, ends, values, winner, width, ROWS: tl.constexpr, CHANNELS: tl.constexpr):
    """The largest relu(x) of each ball, a tile of channels a program, and its row, -1 where it is 0."""
    ball = tl.program_id(0)
    channel = tl.program_id(1) * CHANNELS + tl.arange(0, CHANNELS)
    begin, end = tl.load(ends + ball - 1, mask=ball > 0, other=0), tl.load(ends + ball)
    best = tl.full((CHANNELS,), 0.0, dtype=tl.float32)
    best_row = tl.full((CHANNELS,), -1, dtype=tl.int32)
    poison = tl.zeros((CHANNELS,), dtype=tl.float32)
    for start in range(begin, end, ROWS):
        row = (start + tl.arange(0, ROWS))[:, None]
        inside = (row < end) & (channel[None, :] < width)
        tile = tl.load(x + row.to(tl.int64) * width + channel[None, :], mask=inside, other=0.0).to(tl.float32)
        top = tl.max(tile, axis=0)
        top_row = tl.min(tl.where(tile == top[None, :], row, end), axis=0)
        best_row = tl.where(top > best, top_row, best_row)
        best = tl.maximum(best, top)
        poison += tl.sum(tile - tile, axis=0)  # 0, or NaN where there is one: a max would hide it
    at = ball.to(tl.int64) * width + channel
    tl.store(values + at, best + poison, mask=channel < width)
    tl.store(winner + at, best_row, mask=channel < width)


@triton.jit
def input_gradient(
    grad,
    winner,
    x,
    centres,
    owner,
    neighbour,
    ends,
    groups,
    weight,
    out,
    c_in,
    c_out,
    SPARSE: tl.constexpr,
    GATHER: tl.constexpr,
    PRECISION: tl.constexpr,
    TYPE: tl.constexpr,
    ROWS: tl.constexpr,
    IN: tl.constexpr,
    OUT: tl.constexpr,
):
    """The gradient of x from that of the result of `linear`: a tile of rows and channels a program."""
    total = tl.load(ends + groups - 1)
    if tl.program_id(0) * ROWS < total:
        row = (tl.program_id(0) * ROWS + tl.arange(0, ROWS))[:, None]
        below = tl.program_id(1) * IN + tl.arange(0, IN)
        result = tl.zeros((ROWS, IN), dtype=tl.float32)
        for start in range(0, c_out, OUT):
            above = start + tl.arange(0, OUT)
            tile = _gradients(grad, winner, owner, row, row < total, above[None, :], c_out, SPARSE)
            inside = (above[:, None] < c_out) & (below[None, :] < c_in)
            factor = tl.load(weight + above[:, None] * c_in + below[None, :], mask=inside, other=0.0)
            result = tl.dot(tile.to(TYPE), factor.to(TYPE), result, input_precision=PRECISION)
        tile = _inputs(x, centres, owner, neighbour, row, row < total, below[None, :], c_in, GATHER)
        at = out + row.to(tl.int64) * c_in + below[None, :]
        inside = (row < total) & (below[None, :] < c_in)
        tl.store(at, tl.where(tile > 0.0, result, 0.0).to(TYPE), mask=inside)


@triton.jit
def weight_gradient(
    grad,
    winner,
    x,
    centres,
    owner,
    neighbour,
    ends,
    groups,
    weights,
    biases,
    c_in,
    c_out,
    splits,
    SPARSE: tl.constexpr,
    GATHER: tl.constexpr,
    PRECISION: tl.constexpr,
    TYPE: tl.constexpr,
    ROWS: tl.constexpr,
    IN: tl.constexpr,
    OUT: tl.constexpr,
):
    """The gradients of W and b: a tile of W, and every n-th tile of rows, a program."""
    total = tl.load(ends + groups - 1)
    above = (tl.program_id(1) * OUT + tl.arange(0, OUT))[:, None]
    below = (tl.program_id(2) * IN + tl.arange(0, IN))[None, :]
    result = tl.zeros((OUT, IN), dtype=tl.float32)
    sums = tl.zeros((OUT,), dtype=tl.float32)
    for start in range(tl.program_id(0) * ROWS, total, splits * ROWS):
        row = start + tl.arange(0, ROWS)
        upper = _gradients(grad, winner, owner, row[None, :], row[None, :] < total, above, c_out, SPARSE)
        tile = _inputs(x, centres, owner, neighbour, row[:, None], row[:, None] < total, below, c_in, GATHER)
        result = tl.dot(upper.to(TYPE), _relu(tile).to(TYPE), result, input_precision=PRECISION)
        sums += tl.sum(upper.to(tl.float32), axis=1)
    split = tl.program_id(0).to(tl.int64)
    inside = (above < c_out) & (below < c_in)
    tl.store(weights + (split * c_out + above) * c_in + below, result, mask=inside)
    if tl.program_id(2) == 0:
        channel = tl.program_id(1) * OUT + tl.arange(0, OUT)
        tl.store(biases + split * c_out + channel, sums, mask=channel < c_out)


@triton.jit
def scatter(grad, neighbour, ends, points, centres, width, ROWS: tl.constexpr, CHANNELS: tl.constexpr):
    """The rows of each ball added to their points, and their sum subtracted from its centre."""
    ball = tl.program_id(0)
    channel = (tl.program_id(1) * CHANNELS + tl.arange(0, CHANNELS))[None, :]
    begin, end = tl.load(ends + ball - 1, mask=ball > 0, other=0), tl.load(ends + ball)
    total = tl.zeros((ROWS, CHANNELS), dtype=tl.float32)
    for start in range(begin, end, ROWS):
        row = (start + tl.arange(0, ROWS))[:, None]
        inside = (row < end) & (channel < width)
        tile = tl.load(grad + row.to(tl.int64) * width + channel, mask=inside, other=0.0).to(tl.float32)
        point = tl.load(neighbour + row, mask=row < end, other=0).to(tl.int64)
        tl.atomic_add(points + point * width + channel, tile, mask=inside, sem="relaxed")
        total += tile
    channel = tl.program_id(1) * CHANNELS + tl.arange(0, CHANNELS)
    tl.store(centres + ball.to(tl.int64) * width + channel, -tl.sum(total, axis=0), mask=channel < width)
