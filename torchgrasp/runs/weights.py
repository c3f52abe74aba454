"""Weights to hand on: one safetensors file with the configuration that rebuilds the networks."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

import torchgrasp
from torchgrasp.errors import CheckpointError, ConfigError

_SEPARATOR = "/"
# The policy that comes with the library; pretrained.json beside it tells how it was trained and what it does.
PRETRAINED = Path(torchgrasp.__file__).parent / "weights" / "pretrained.safetensors"


def save_weights(
    path: str | Path, modules: Mapping[str, nn.Module | Mapping[str, Tensor]], config: Mapping[str, Any]
) -> None:
    """Write the state_dicts of `modules` and the JSON-able `config` to the file `path`, all or nothing.

    Tensors are named "<module>/<parameter>"; metadata hold the config, so that any safetensors
    reader gets at both.
    """
    path = Path(path)
    tensors = {}
    for name, module in modules.items():
        state = module.state_dict() if isinstance(module, nn.Module) else module
        tensors |= {f"{name}{_SEPARATOR}{key}": _own(value) for key, value in state.items()}
    try:
        text = json.dumps(dict(config))
    except TypeError as error:
        raise ConfigError(
            f"The config of {path} is not plain ({error}): resolve it to dicts first."
        ) from error
    metadata = {"config": text, "modules": json.dumps(list(modules)), "torchgrasp": torchgrasp.__version__}
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.new")
    save_file(tensors, part, metadata=metadata)
    with part.open("rb") as stream:
        os.fsync(stream.fileno())
    part.replace(path)


def load_weights(path: str | Path) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """Read (state_dicts by module name, config) from a file of `save_weights`; nothing is unpickled."""
    if not Path(path).is_file():
        raise CheckpointError(f"There is no weights file at {path}: give the path of a .safetensors file.")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            states = {name: {} for name in json.loads(metadata["modules"])}
            for key in file.keys():  # noqa: SIM118 - safe_open is no mapping
                name, parameter = key.split(_SEPARATOR, 1)
                states[name][parameter] = file.get_tensor(key)
            return states, json.loads(metadata["config"])
    except (SafetensorError, ValueError, KeyError, OSError, RuntimeError) as error:
        raise CheckpointError(
            f"{path} is damaged or no weights file of torchgrasp ({error}): get the file again."
        ) from error


def _own(value: Tensor) -> Tensor:
    # Tied parameters share memory, which safetensors refuses to write.
    return value.detach().cpu().clone(memory_format=torch.contiguous_format)
