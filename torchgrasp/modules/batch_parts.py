"""A batch through an encoder in parts, by threads that wait for each other once a pass.

The threads of OpenMP meet after every operation, and spin until the last has come: beside another busy
process each operation waits for that process's turn. Parts of a batch meet at the end alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchgrasp.errors import check_whole
from torchgrasp.modules.pooling import is_traced

# Below it, starting a thread costs more than the thread saves.
_LEAST_ROWS = 16

T = TypeVar("T")


class _Threads:
    """How many parts there are, and the threads for all but the first of them, in this process."""

    def __init__(self) -> None:
        self.number, self.pool = 1, None

    def set(self, number: int) -> None:
        if self.pool is not None:
            self.pool.shutdown()
        self.number, self.pool = number, ThreadPoolExecutor(number - 1) if number > 1 else None

    def forget(self) -> None:
        """In a process that was forked, to which no threads have come."""
        self.number, self.pool = 1, None

    def map(self, work: Callable[[T], Any], items: list[T]) -> list[Any]:
        if self.pool is None:  # a backward pass after the block
            return [work(item) for item in items]
        others = [self.pool.submit(work, item) for item in items[1:]]
        first = work(items[0])
        return [first, *(each.result() for each in others)]


_threads = _Threads()
os.register_at_fork(after_in_child=_threads.forget)


@contextmanager
def batches_in_parts(number: int) -> Iterator[None]:
    """Have the encoders of actors, critics and goal predictors take large batches in `number` parts.

    On the CPU alone, and for encoders whose rows do not depend on one another. A feature made in parts
    has one backward pass: sum the losses that share it. Sums over the batch are
    rounded otherwise than in one piece, and alike at each call. Give torch its share of the cores for
    each (``torch.set_num_threads``) meanwhile.

    >>> from torchgrasp.modules import PointNet
    >>> encoder, clouds = PointNet(3), torch.rand(64, 32, 3)
    >>> with batches_in_parts(2):
    ...     feature = encode_in_parts(encoder, clouds)
    >>> torch.allclose(feature, encoder(clouds), atol=1e-6)
    True
    """
    check_whole("number", number, 1)
    before = _threads.number
    _threads.set(number)
    try:
        yield
    finally:
        _threads.set(before)


def encode_in_parts(encoder: nn.Module, observed: Tensor) -> Tensor:
    """What `encoder` makes of (B, ...) inputs, in parts where `batches_in_parts` says so and it pays."""
    if _threads.number == 1 or not _can_be_parted(encoder, observed):
        return encoder(observed)
    if torch.is_grad_enabled():
        return _Parted.apply(encoder, observed, *_list_weights(encoder))
    return torch.cat(_threads.map(torch.no_grad()(encoder), _split(observed)))


def _can_be_parted(encoder: nn.Module, observed: Tensor) -> bool:
    elsewhere = is_traced() or torch.is_inference_mode_enabled() or torch.is_autocast_enabled("cpu")
    large = observed.ndim > 2 and _count_parts(observed) > 1
    if elsewhere or not large or observed.device.type != "cpu":
        return False
    # A hook would see each part's gradient.
    return goes_in_parts(encoder) and not any(each._backward_hooks for each in _list_weights(encoder))


def goes_in_parts(encoder: nn.Module) -> bool:
    """Whether `batches_in_parts` has an effect on the encoder: each row is its own, nothing is drawn."""
    independent = getattr(encoder, "rows_are_independent", False)
    # Threads would draw from one generator in any order.
    return independent and not any(getattr(each, "start", None) == "random" for each in encoder.modules())


def _count_parts(observed: Tensor) -> int:
    return min(_threads.number, len(observed) // _LEAST_ROWS)


def _split(observed: Tensor) -> list[Tensor]:
    return list(observed.split(-(-len(observed) // _count_parts(observed))))


def _list_weights(encoder: nn.Module) -> list[Tensor]:
    """What learns of an encoder, each once; a loss keeps tensors in place of parameters."""
    held = (
        value for each in encoder.modules() for value in (*each._parameters.values(), *vars(each).values())
    )
    learning = {id(value): value for value in held if isinstance(value, Tensor) and value.requires_grad}
    return [*learning.values()]


class _Parted(torch.autograd.Function):
    """Forward and backward of an encoder, each with a thread a part."""

    @staticmethod
    def forward(ctx: Any, encoder: nn.Module, observed: Tensor, *weights: Tensor) -> Tensor:
        def run(part: Tensor) -> tuple[Tensor, Tensor]:
            with torch.enable_grad():
                part.requires_grad_(ctx.needs_input_grad[1])
                return part, encoder(part)

        ctx.passes = _threads.map(run, [part.detach() for part in _split(observed)])
        ctx.weights = weights
        return torch.cat([feature.detach() for _, feature in ctx.passes])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        if ctx.passes is None:
            raise RuntimeError(
                "A feature made in parts has one backward pass: sum the losses before it, or leave "
                "batches_in_parts out."
            )
        passes, ctx.passes = ctx.passes, None
        to_input = ctx.needs_input_grad[1]

        def run(item: tuple[tuple[Tensor, Tensor], Tensor]) -> tuple[Tensor | None, ...]:
            (part, feature), gradient = item
            inputs = [*[part] * to_input, *ctx.weights]
            found = torch.autograd.grad(feature, inputs, gradient, allow_unused=True)
            return found if to_input else (None, *found)

        sizes = [len(part) for part, _ in passes]
        found = _threads.map(run, list(zip(passes, gradients[0].split(sizes), strict=True)))
        observed = torch.cat([each[0] for each in found]) if to_input else None
        return None, observed, *(_add(each) for each in zip(*(each[1:] for each in found), strict=True))


def _add(gradients: tuple[Tensor | None, ...]) -> Tensor | None:
    """The sum of what the parts gave, always in their order."""
    given = [each for each in gradients if each is not None]
    return sum(given[1:], start=given[0]) if given else None
