"""Max over rows that pass through one shared network, at the cost of the rows that win.

The gradient of a max reaches only the row that attains it, and few of a cloud's points attain any
channel's maximum (PointNet's "critical points"). So all rows pass once without a graph, and the
winners again with one: the same values and the same gradients, three to six times faster on a CPU.

vmap and torch.compile cannot follow a choice of rows by their values: under them every row passes with
a graph, to the same result.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from torchgrasp.ops import group

# Rows per chunk of the pass without a graph: their activations then stay in the processor's cache.
_CHUNK_ROWS = 2048


def max_over_rows(layers: nn.Module, rows: Tensor, *, independent: bool = True) -> Tensor:
    """(G, K, C) rows through `layers`, one by one, then the max over K: (G, F).

    `independent` says that `layers` treat each row on its own (linear, activation, LayerNorm; not
    BatchNorm): otherwise every row passes with a graph.
    """
    if not (independent and _chooses_rows()):
        return _max_of_all(layers, rows)
    flat = rows.flatten(0, 1)
    every = torch.ones(rows.shape[:2], dtype=torch.bool, device=rows.device)
    return _max_over_groups(layers, lambda i: flat.index_select(0, i), every, needs_graph=rows.requires_grad)


def max_over_neighbours(
    layers: nn.Module, points: Tensor, centres: Tensor, index: Tensor, *, independent: bool = True
) -> Tensor:
    """Max over K of `layers` applied to ``points[index] - centres``: (B, M, F).

    `points` is (B, N, C), `centres` (B, M, C) and `index` (B, M, K) says which of the N points are a
    centre's neighbours. `layers` and `independent` as for `max_over_rows`. Places that repeat a centre's
    first neighbour, as `ops.ball_query` fills them, cost nothing.
    """
    (clouds, num_centres, k), num_points = index.shape, points.shape[1]
    if not (independent and _chooses_rows()):
        return _max_of_all(layers, group(points, index) - centres[:, :, None])
    first = num_points * torch.arange(clouds, device=index.device)[:, None, None]
    neighbour = (index + first).flatten()
    points, centres = points.flatten(0, 1), centres.flatten(0, 1)

    def rows(i: Tensor) -> Tensor:
        return points.index_select(0, neighbour[i]) - centres.index_select(0, i // k)

    distinct = index != index[..., :1]
    distinct[..., 0] = True
    needs_graph = points.requires_grad or centres.requires_grad
    pooled = _max_over_groups(layers, rows, distinct.flatten(0, 1), needs_graph=needs_graph)
    return pooled.unflatten(0, (clouds, num_centres))


def _max_of_all(layers: nn.Module, rows: Tensor) -> Tensor:
    """The max over K of `layers` applied to all of (*, K, C) rows: (*, F)."""
    return layers(rows.flatten(0, -2)).unflatten(0, rows.shape[:-1]).amax(dim=-2)


def _chooses_rows() -> bool:
    """Whether rows may be chosen by their values: not while functorch or a compiler traces."""
    if torch.compiler.is_compiling():
        return False
    return torch._C._functorch.peek_interpreter_stack() is None  # pyright: ignore


def _max_over_groups(
    layers: nn.Module, rows: Callable[[Tensor], Tensor], counts: Tensor, *, needs_graph: bool
) -> Tensor:
    """The max over K of G groups of K rows; `rows` makes the rows of given numbers.

    `counts` (G, K) says which rows count; a group's first must. `needs_graph` says whether what the
    rows are made from needs gradients.
    """
    device = counts.device.type
    # Autocast would keep weights that it casts here, where they have no gradient, for the second pass.
    uncached = torch.autocast(device, enabled=torch.is_autocast_enabled(device), cache_enabled=False)
    with torch.no_grad(), uncached:
        values, winner = _winners(layers, rows, counts)
    if not (torch.is_grad_enabled() and (needs_graph or _any_trained(layers))):
        return values
    wins = torch.zeros(counts.numel(), dtype=torch.bool, device=counts.device)
    wins[winner.flatten()] = True
    place = (wins.cumsum(0) - 1)[winner]  # of each winner among the rows kept, (G, F)
    values = layers(rows(wins.nonzero().squeeze(-1)))
    channels = values.shape[-1]
    cell = place * channels + torch.arange(channels, device=counts.device)
    return values.flatten().gather(0, cell.flatten()).view(cell.shape)


def _any_trained(layers: nn.Module) -> bool:
    return any(p.requires_grad for p in layers.parameters())


def _winners(layers: nn.Module, rows: Callable[[Tensor], Tensor], counts: Tensor) -> tuple[Tensor, Tensor]:
    """Values of the max over each group, and the numbers of the rows that attain it, both (G, F)."""
    groups, k = counts.shape
    step = max(1, _CHUNK_ROWS // k) if counts.device.type == "cpu" else groups
    values, winner = [], []
    for start in range(0, max(groups, 1), step):  # of no groups, the pass of no rows tells F
        pooled = _pool(layers, rows, counts[start : start + step], start * k)
        values.append(pooled[0])
        winner.append(pooled[1])
    return torch.cat(values), torch.cat(winner)


def _pool(
    layers: nn.Module, rows: Callable[[Tensor], Tensor], counts: Tensor, first: int
) -> tuple[Tensor, Tensor]:
    """`_winners` of the groups whose rows start at number `first`."""
    groups, k = counts.shape
    number = torch.arange(first, first + groups * k, device=counts.device)
    if counts.all():
        values = layers(rows(number))
    else:
        place = (counts.flatten().cumsum(0) - 1).view(groups, k)
        place = torch.where(counts, place, place[:, :1])
        values = layers(rows(number[counts.flatten()])).index_select(0, place.flatten())
    pooled = values.unflatten(0, (groups, k)).max(dim=1)
    return pooled.values, pooled.indices + number[::k, None]
