"""Whole updates with little Python between their operations: compiled, or recorded as CUDA graphs."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from torchgrasp.errors import ConfigError

# From a batch (B) to new tensors, without gradients; it trains on the way.
Update = Callable[[TensorDictBase], TensorDictBase]
CompileMode = Literal["default", "reduce-overhead"]

# Updates of a kind that run as they are before one is recorded: libraries and kernels make themselves ready,
# moments come into being, and torch.compile has seen both.
_WARMUP = 4
# What an optimizer is made for, and what stands for it in a checkpoint.
_PLAIN = {"capturable": False, "fused": None, "foreach": None}


@dataclass(frozen=True)
class Acceleration:
    """How a learner's updates are run; the default runs them as they are.

    Attributes:
        compile: mode of torch.compile for whole updates; None does not compile. 'reduce-overhead' replays
            what it can as CUDA graphs of its own.
        cudagraphs: whether each kind of update, compiled or not, is recorded as a CUDA graph and replayed;
            "auto" goes on without, after a warning, where one cannot be recorded.
        device: of networks and batches.

    Example:
        >>> Acceleration().wrap(lambda batch: batch.sum())
        <function <lambda> at ...>
    """

    compile: CompileMode | None = None
    cudagraphs: bool | Literal["auto"] = False
    device: torch.device | str = "cpu"

    def __post_init__(self) -> None:
        if self.compile not in (None, "default", "reduce-overhead"):
            raise ConfigError(
                f"compile={self.compile!r} is unknown: give 'default', 'reduce-overhead', or None for none."
            )
        if self.cudagraphs and self.compile == "reduce-overhead":
            raise ConfigError(
                "compile='reduce-overhead' replays CUDA graphs of its own: give compile='default' beside "
                "cudagraphs=True, or leave cudagraphs out."
            )
        if self.cudagraphs and torch.device(self.device).type != "cuda":
            raise ConfigError(f"cudagraphs=True with device={self.device}: give a CUDA device, or False.")

    @cached_property
    def _pool(self) -> Any:
        """Memory that all recordings share: no two run at once, and what they return is copied out of it."""
        return torch.cuda.graph_pool_handle()

    @property
    def active(self) -> bool:
        """Whether updates are compiled or recorded."""
        return bool(self.cudagraphs) or self.compile is not None

    def wrap(self, update: Update, generators: Sequence[torch.Generator] = ()) -> Update:
        """The update, run this way; `generators` are those that it draws from beside torch's own."""
        if self.compile is not None:
            update = _CompiledUpdate(update, self.compile)
        if not self.cudagraphs:
            return update
        return RecordedUpdate(
            update, generators, device=self.device, pool=self._pool, required=self.cudagraphs is True
        )

    def make_adam(self, parameters: Iterable[nn.Parameter]) -> Adam:
        """Adam that can be part of such an update: its rate is a tensor, which `set_rate` fills."""
        if not self.active:
            return Adam(parameters)
        on_gpu = torch.device(self.device).type == "cuda"
        rate = torch.tensor(1e-3, device=self.device)
        adam = Adam(parameters, lr=rate, capturable=on_gpu, fused=True if on_gpu else None)
        # Its first steps come before anything is recorded, of which torch would warn.
        vars(adam)["_warned_capturable_if_run_uncaptured"] = True
        return adam


def get_optimizer_state(optimizer: Optimizer) -> dict[str, Any]:
    """The optimizer's state_dict, the same whatever `Acceleration` it was made for."""
    state = optimizer.state_dict()
    groups = [{**group, "lr": float(group["lr"])} for group in state["param_groups"]]
    for group in groups:
        group.update({name: plain for name, plain in _PLAIN.items() if name in group})
    return {**state, "param_groups": groups}


def load_optimizer_state(optimizer: Optimizer, state: Mapping[str, Any]) -> None:
    """Take up what `get_optimizer_state` gave, into an optimizer that stays of its own kind."""
    kept = [{name: group[name] for name in _PLAIN if name in group} for group in optimizer.param_groups]
    rates = [group["lr"] for group in optimizer.param_groups]
    groups = [{**saved, **own} for saved, own in zip(state["param_groups"], kept, strict=True)]
    optimizer.load_state_dict({**state, "param_groups": groups})
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        if isinstance(rate, Tensor):
            group["lr"] = rate.fill_(float(group["lr"]))


class _CompiledUpdate:
    """An update by torch.compile; what it returns stays as it is when it runs again."""

    def __init__(self, update: Update, mode: CompileMode) -> None:
        self._update: Any = torch.compile(update, mode=mode)
        self._has_graphs = mode == "reduce-overhead"

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        if not self._has_graphs:
            return self._update(batch)
        torch.compiler.cudagraph_mark_step_begin()
        return self._update(batch).clone()


class RecordedUpdate:
    """An update that is recorded as a CUDA graph once for each form of batches, and replayed for the others.

    The first four batches of a form are learned from as they are, the fifth is recorded. Everything that
    the update changes, and what it draws from, must stay where it is in memory: make another where
    parameters or moments are replaced. Unlike tensordict's CudaGraphModule it does not wait for the device at
    every call, takes generators, and lets other threads go on meanwhile.

    Args:
        update: that only ever does the same: no shape and no choice depends on values.
        generators: CUDA generators that it draws from beside torch's own.
        device: the CUDA device on which all of it is.
        required: whether an update that cannot be recorded is an error; otherwise it runs as it is.
        pool: of memory, of `torch.cuda.graph_pool_handle`, that updates share which never run at once.
    """

    def __init__(
        self,
        update: Update,
        generators: Sequence[torch.Generator] = (),
        *,
        device: torch.device | str = "cuda",
        required: bool = True,
        pool: Any = None,
    ) -> None:
        self._update, self._generators, self._pool = update, tuple(generators), pool
        self._device, self._required = torch.device(device), required
        self._stream = torch.cuda.Stream(self._device)
        self._calls: dict[tuple, int] = {}
        self._recordings: dict[tuple, _Recording] = {}
        self._given_up = False

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Learn from a batch (B); what is returned is the caller's."""
        with torch.cuda.device(self._device):
            return self._run(batch)

    def _run(self, batch: TensorDictBase) -> TensorDictBase:
        inputs = dict(batch.items(True, True))
        form = tuple((key, value.shape, value.dtype) for key, value in inputs.items())
        if form in self._recordings:
            return self._recordings[form].replay(inputs)
        self._calls[form] = self._calls.get(form, 0) + 1
        if self._calls[form] <= _WARMUP:
            return self._warm_up(batch)
        if self._given_up:
            return self._update(batch.copy())
        try:
            self._recordings[form] = self._record(batch)
        except ConfigError as error:
            if self._required:
                raise
            warnings.warn(f"Updates run without CUDA graphs. {error}", stacklevel=1)
            self._given_up = True
            return self._update(batch.copy())
        return self._recordings[form].replay(inputs)

    def _record(self, batch: TensorDictBase) -> _Recording:
        graph, held = torch.cuda.CUDAGraph(), batch.clone()
        for generator in self._generators:
            graph.register_generator_state(generator)
        # Errors of this thread alone: others pin memory meanwhile.
        record = torch.cuda.graph(
            graph, pool=self._pool, stream=self._stream, capture_error_mode="thread_local"
        )
        try:
            with record:
                output = self._update(held.copy())
        except RuntimeError as error:
            first = error.__context__ or error  # the end of a recording that failed fails too
            raise ConfigError(
                f"cudagraphs=true: this update cannot be recorded ({str(first).splitlines()[0]}). A part of "
                "it reads values on the host, or has shapes that depend on values: give cudagraphs=false."
            ) from error
        return _Recording(graph, dict(held.items(True, True)), output)

    def _warm_up(self, batch: TensorDictBase) -> TensorDictBase:
        current = torch.cuda.current_stream()
        self._stream.wait_stream(current)
        with torch.cuda.stream(self._stream):
            output = self._update(batch.copy())
        current.wait_stream(self._stream)
        return output


@dataclass(frozen=True)
class _Recording:
    """An update as a CUDA graph, and the memory that it reads its batch from and writes its results to."""

    graph: torch.cuda.CUDAGraph
    inputs: Mapping[Any, Tensor]
    output: TensorDictBase

    def replay(self, inputs: Mapping[Any, Tensor]) -> TensorDictBase:
        """The update on other leaves of a batch of that form."""
        for key, value in self.inputs.items():
            value.copy_(inputs[key])
        self.graph.replay()
        return self.output.clone()
