"""The network of a policy as a file that needs no torchgrasp: ONNX, or PyTorch's exported program."""

from __future__ import annotations

import importlib
import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from torchgrasp import keys
from torchgrasp.config.trained_policy import TrainedPolicy
from torchgrasp.config.trained_view import make_view, training_lens
from torchgrasp.data.files import write_bytes_atomically
from torchgrasp.errors import ConfigError, MissingPackageError

# What the file's network may differ by from the policy's own on a state, in the units of actions and goals.
_AGREES = 1e-4


def list_outputs(policy: TrainedPolicy) -> list[str]:
    """What the exported network says: the action and, where there is one, the goal."""
    return [key for key in (keys.ACTION, keys.GOAL_PREDICTION) if key in policy.out_keys]


def list_inputs(policy: TrainedPolicy) -> list[str]:
    """What the exported network reads, by names.

    Raises:
        ConfigError: where it reads what has no plain name.
    """
    nested = [key for key in policy.in_keys if not isinstance(key, str)]
    if nested:
        raise ConfigError(f"policy reads {nested[0]}, which has no plain name: it cannot be exported.")
    return [str(key) for key in policy.in_keys]


def make_state(policy: TrainedPolicy) -> dict[str, Tensor]:
    """What a policy reads of a made-up picture, (1, ...) each: the shapes of its inputs."""
    lens = training_lens(policy)
    mask = torch.zeros(1, lens.height, lens.width, dtype=torch.bool)
    mask[:, lens.height // 3 : lens.height // 2, lens.width // 3 : lens.width // 2] = True
    hand = torch.eye(4)[None] * torch.tensor([1.0, -1.0, -1.0, 1.0])
    hand[:, :3, 3] = torch.tensor([0.5, 0.0, 0.5])
    seen = {
        keys.DEPTH: torch.full(mask.shape, 0.4),
        keys.MASK: mask,
        keys.T_BASE_EE: hand,
        keys.T_BASE_CAMERA: hand.clone(),
        keys.JOINTS: torch.zeros(1, 9),
        keys.TIME_LEFT: torch.ones(1, 1),
        keys.WORLD: torch.zeros(1, 1, dtype=torch.int64),
        keys.EPISODE: torch.zeros(1, 1, dtype=torch.int64),
    }
    observed = TensorDict({}, [1])
    for key, value in seen.items():
        observed[key] = value
    state = make_view(policy, intrinsics=lens, table_height=0.0).look(observed, begins=True)
    return {name: state[name] for name in list_inputs(policy)}


def trace_network(policy: TrainedPolicy) -> torch.export.ExportedProgram:
    """The network as PyTorch's exported program: tensors (B, ...) in, by `list_inputs`, and out.

    Raises:
        ConfigError: where it cannot be traced, or needs operators that PyTorch alone does not have.
    """
    network, state = _Network(policy), make_state(policy)
    batch = torch.export.Dim("batch", min=1, max=1024)
    two = tuple(value.repeat(2, *[1] * (value.ndim - 1)) for value in state.values())
    try:
        with _quiet():
            program = torch.export.export(network, two, dynamic_shapes=(tuple({0: batch} for _ in two),))
    except Exception as error:  # torch.export raises whatever its tracing meets
        told = str(error).strip().splitlines() or [type(error).__name__]
        raise ConfigError(f"policy cannot be exported, its network cannot be traced ({told[0]}).") from error
    foreign = {each for each in _find_operators(program) if each.split("::")[0] not in ("aten", "prim")}
    if foreign:
        raise ConfigError(
            f"policy cannot be exported: its network needs {', '.join(sorted(foreign))}, which PyTorch alone "
            "does not have. A PointNet encoder (model=pointnet) needs no operator of its own."
        )
    return program


def write_torch(policy: TrainedPolicy, file: Path) -> None:
    """Write the network as an exported program (`.pt2`), for `torch.export.load`."""
    program = trace_network(policy)
    _forget_places(program)
    buffer = io.BytesIO()  # a file's name would stand in the archive
    with _quiet():
        torch.export.save(program, buffer)
    write_bytes_atomically(file, buffer.getvalue())


def write_onnx(policy: TrainedPolicy, file: Path) -> None:
    """Write the network as ONNX, and compare it with the policy's own on a state.

    Raises:
        MissingPackageError: without the extra `export`.
        ConfigError: where it cannot be exported, or the file's network says something else.
    """
    onnx, runtime = (import_export(name) for name in ("onnx", "onnxruntime"))
    import_export("onnxscript")
    program = trace_network(policy)
    names: Any = {"input_names": list_inputs(policy), "output_names": list_outputs(policy)}
    try:
        with _quiet():
            written: Any = torch.onnx.export(program, dynamo=True, verbose=False, **names)
    except Exception as error:  # as above
        told = str(error).strip().splitlines() or [type(error).__name__]
        raise ConfigError(f"policy cannot be exported: ONNX has no way to say it ({told[0]}).") from error
    model = written.model_proto
    _forget_origins(model.graph)
    onnx.checker.check_model(model)
    _compare(policy, runtime.InferenceSession(model.SerializeToString()))
    write_bytes_atomically(file, model.SerializeToString())


def import_export(name: str) -> Any:
    """A package of the extra `export`."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingPackageError(
            f'Export to ONNX needs {name} ({error}): pip install "torchgrasp[export]".'
        ) from error


class _Network(nn.Module):
    """A policy from tensors to tensors."""

    def __init__(self, policy: TrainedPolicy) -> None:
        super().__init__()
        self.policy, self.reads, self.says = policy, list_inputs(policy), list_outputs(policy)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        state = TensorDict(dict(zip(self.reads, inputs, strict=True)), [inputs[0].shape[0]])
        said = self.policy(state)
        return tuple(said[key] for key in self.says)


def _compare(policy: TrainedPolicy, session: Any) -> None:
    state = make_state(policy)
    given = {name: value.numpy() for name, value in state.items()}
    with torch.no_grad():
        expected = _Network(policy)(*state.values())
    for name, ours, theirs in zip(list_outputs(policy), expected, session.run(None, given), strict=True):
        if not np.abs(ours.numpy() - theirs).max() <= _AGREES:
            raise ConfigError(f"policy cannot be exported: the file's network says another {name}.")


def _find_operators(program: torch.export.ExportedProgram) -> set[str]:
    modules = [each for each in program.graph_module.modules() if isinstance(each, torch.fx.GraphModule)]
    nodes = (node.target for module in modules for node in module.graph.nodes if node.op == "call_function")
    return {each.name() for each in nodes if isinstance(each, torch._ops.OpOverload)}


def _forget_places(program: torch.export.ExportedProgram) -> None:
    """Leave out the lines of code that nodes came from: they name folders of this machine."""
    for module in program.graph_module.modules():
        for node in module.graph.nodes if isinstance(module, torch.fx.GraphModule) else ():
            node.meta.pop("stack_trace", None)


def _forget_origins(graph: Any) -> None:
    """The same in ONNX, whose nodes and values tell where they came from."""
    for each in (*graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer):
        del each.metadata_props[:]
        each.doc_string = ""
        for attribute in getattr(each, "attribute", ()):
            for inner in (*[attribute.g] * attribute.HasField("g"), *attribute.graphs):
                _forget_origins(inner)
    del graph.metadata_props[:]
    graph.doc_string = ""


@contextmanager
def _quiet() -> Iterator[None]:
    """Without torch's words on packages that are not needed here, and on its own deprecations."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
