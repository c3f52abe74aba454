"""Weights to hand on: one safetensors file with the configuration that rebuilds the networks."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

import torchgrasp
from torchgrasp.data.files import write_bytes_atomically, writing
from torchgrasp.documents import Document, Name, Plain, check_document, parse_json, reading
from torchgrasp.errors import CheckpointError, ConfigError

_SEPARATOR = "/"
_REMEDY = "get the file again"
# Files of this version have no checksum.
_UNGUARDED = "0.1."
# The policy that comes with the library; pretrained.json beside it tells how it was trained and what it does.
PRETRAINED = Path(torchgrasp.__file__).parent / "weights" / "pretrained.safetensors"


class WeightsMetadata(Document):
    """The metadata of a weights file, texts as safetensors has them.

    Attributes:
        config: JSON of the configuration that rebuilds the networks.
        modules: JSON of the modules' names.
        torchgrasp: the version that wrote the file.
        sha256: of `config`, `modules` and all tensors.
    """

    config: str
    modules: str
    torchgrasp: Name
    sha256: str | None = None


class WeightsContents(Document):
    """What the JSON in a weights file's metadata says."""

    config: Plain
    modules: list[Name]


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
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigError(
            f"The config of {path} is not plain ({error}): resolve it to dicts first."
        ) from error
    names = json.dumps(list(modules))
    _read_contents(text, names, path)
    metadata = WeightsMetadata(
        config=text,
        modules=names,
        torchgrasp=torchgrasp.__version__,
        sha256=_digest((text, names), tensors),
    )
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes_atomically(path, save(tensors, metadata=metadata.model_dump()))


def load_weights(path: str | Path) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """Read (state_dicts by module name, config) from a file of `save_weights`; nothing is unpickled.

    CheckpointError names a file that is missing, damaged, or no longer as its checksum tells.
    """
    with reading(Path(path), _REMEDY):
        there = Path(path).is_file()
    if not there:
        raise CheckpointError(f"There is no weights file at {path}: give the path of a .safetensors file.")
    try:
        with reading(Path(path), _REMEDY), safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 - no mapping
    except (SafetensorError, KeyError, RuntimeError) as error:
        raise CheckpointError(
            f"{path} is damaged or no weights file of torchgrasp ({error}): {_REMEDY}."
        ) from error
    told = check_document(metadata, WeightsMetadata, path, f"it is no weights file of torchgrasp, {_REMEDY}")
    contents = _read_contents(told.config, told.modules, path)
    _check_digest(told, tensors, path)
    return _group(tensors, contents.modules, path), contents.config


def _read_contents(config: str, modules: str, path: str | Path) -> WeightsContents:
    parts = {
        name: parse_json(text, f"{path}: {name}", _REMEDY)
        for name, text in (("config", config), ("modules", modules))
    }
    return check_document(parts, WeightsContents, path, _REMEDY)


def _check_digest(told: WeightsMetadata, tensors: Mapping[str, Tensor], path: str | Path) -> None:
    if told.sha256 is None and told.torchgrasp.startswith(_UNGUARDED):
        return
    if told.sha256 != _digest((told.config, told.modules), tensors):
        raise CheckpointError(
            f"{path} was changed after it was saved (its checksum differs, or is missing): {_REMEDY}."
        )


def _digest(texts: Iterable[str], tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 of texts and named tensors, of these also types and shapes, whatever their order."""
    digest = hashlib.sha256()
    for text in texts:
        digest.update(f"{len(text)} {text}".encode())
    for name, value in sorted(tensors.items()):
        digest.update(f"{len(name)} {name} {value.dtype} {list(value.shape)}".encode())
        digest.update(value.contiguous().reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _group(
    tensors: Mapping[str, Tensor], modules: Iterable[str], path: str | Path
) -> dict[str, dict[str, Tensor]]:
    """The tensors by module and parameter."""
    states: dict[str, dict[str, Tensor]] = {name: {} for name in modules}
    for key, value in tensors.items():
        name, separator, parameter = key.partition(_SEPARATOR)
        if not separator or name not in states:
            raise CheckpointError(f"{path} has the tensor {key!r} of no module that it names: {_REMEDY}.")
        states[name][parameter] = value
    return states


def _own(value: Tensor) -> Tensor:
    # Tied parameters share memory, which safetensors refuses to write.
    return value.detach().cpu().clone(memory_format=torch.contiguous_format)
