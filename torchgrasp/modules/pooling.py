"""Max over rows that pass through one shared network, at the cost of the rows that win.

The gradient of a max reaches only the row that attains it, and few of a cloud's points attain any
channel's maximum (PointNet's "critical points"). So all rows pass once without a graph, and the
winners again with one: the same values and the same gradients, three to six times faster on a CPU.

On a CUDA device nothing waits to learn how many rows win. There the network and max of balls are one
operator (`ops.ball_max`), and of other rows as many pass again as there are channels, if those are fewer.

vmap and torch.compile cannot follow a choice of rows by their values: under them every row passes with
a graph, to the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from torchgrasp.ops import group
from torchgrasp.ops.ball_max import ball_max, serves

# Rows per chunk of the pass without a graph: their activations then stay in the processor's cache.
_CHUNK_ROWS = 2048


def max_over_rows(layers: nn.Module, rows: Tensor, *, independent: bool = True) -> Tensor:
    """(G, K, C) rows through `layers`, one by one, then the max over K: (G, F).

    `independent` says that `layers` treat each row on its own (linear, activation, LayerNorm; not
    BatchNorm): otherwise every row passes with a graph.
    """
    if not independent or is_traced():
        return _max_of_all(layers, rows)
    if rows.is_cuda:
        return _max_over_winners(layers, rows)
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
    if (linears := _linear_layers(layers)) and index.numel() and not _is_transformed() and serves(points):
        weights, biases = zip(*linears, strict=True)
        return ball_max(points, centres, index, weights, biases, _type_of_products(points))
    (clouds, num_centres, k), num_points = index.shape, points.shape[1]
    if not independent or is_traced() or points.is_cuda:
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


def _max_over_winners(layers: nn.Module, rows: Tensor) -> Tensor:
    """`_max_of_all` of (G, K, C) rows, where the row that wins each of F < K / 2 channels carries a graph."""
    channels = next((m.out_features for m in reversed([*layers.modules()]) if isinstance(m, nn.Linear)), None)
    needs_graph = torch.is_grad_enabled() and (rows.requires_grad or _any_trained(layers))
    if channels is None or rows.shape[1] <= 2 * channels or not needs_graph:
        return _max_of_all(layers, rows)
    with _without_graph(rows.device):
        winner = layers(rows.flatten(0, 1)).unflatten(0, rows.shape[:2]).argmax(dim=1)
    kept = rows.gather(1, winner[..., None].expand(-1, -1, rows.shape[-1]))  # (G, F, C)
    return layers(kept.flatten(0, 1)).unflatten(0, winner.shape).diagonal(dim1=1, dim2=2)


def _linear_layers(layers: nn.Module) -> list[tuple[Tensor, Tensor]]:
    """Weight and bias of each linear layer of ReLU, linear, ReLU, ..., ReLU; empty for any other network."""
    parts = list(layers) if isinstance(layers, nn.Sequential) else []
    linears = [part for part in parts[1::2] if type(part) is nn.Linear and part.bias is not None]
    if len(parts) != 2 * len(linears) + 1 or not all(isinstance(part, nn.ReLU) for part in parts[::2]):
        return []
    return [(layer.weight, layer.bias) for layer in linears]


def _type_of_products(points: Tensor) -> torch.dtype:
    """The type that autocast, if any, gives to matrix products."""
    device = points.device.type
    return torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else points.dtype


def is_traced() -> bool:
    """Whether rows may not be chosen by their values: functorch or a compiler traces."""
    return torch.compiler.is_compiling() or _is_transformed()


def _is_transformed() -> bool:
    """Whether functorch traces on its own, without a compiler: that tells nothing of it."""
    if torch.compiler.is_compiling():
        return False
    return torch._C._functorch.peek_interpreter_stack() is not None  # pyright: ignore


def _max_over_groups(
    layers: nn.Module, rows: Callable[[Tensor], Tensor], counts: Tensor, *, needs_graph: bool
) -> Tensor:
    """The max over K of G groups of K rows; `rows` makes the rows of given numbers.

    `counts` (G, K) says which rows count; a group's first must. `needs_graph` says whether what the
    rows are made from needs gradients.
    """
    with _without_graph(counts.device):
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


@contextmanager
def _without_graph(device: torch.device) -> Iterator[None]:
    """Autocast would keep weights that it casts here, where they have no gradient, for the second pass."""
    kind = device.type
    uncached = torch.autocast(kind, enabled=torch.is_autocast_enabled(kind), cache_enabled=False)
    with torch.no_grad(), uncached:
        yield


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
