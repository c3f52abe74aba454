"""State on disk: the one way in which a state_dict becomes JSON and safetensors, and comes back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from torchgrasp.data.packing import pack_tree, unpack_tree
from torchgrasp.documents import parse_json, read_json, reading
from torchgrasp.errors import CheckpointError

_NAME = "state"


def write_state(folder: Path, name: str, state: Any) -> None:
    """Write `state` into the folder as `<name>.json` and, for its tensors, `<name>.safetensors`.

    What it may hold is told by `pack_tree`: state_dicts of modules, optimizers, samplers, replay
    buffers and generators all qualify.
    """
    tree, tensors = pack_tree(state)
    text = json.dumps(tree)
    # What could not be read again must not take the place of what can.
    parse_json(text, f"The state {name!r}", "keep long lists in tensors, and nest them less")
    (folder / f"{name}.json").write_text(text)
    file = folder / f"{name}.safetensors"
    if tensors:
        save_file(_separate(tensors), file)
    else:  # of another state, written here before
        file.unlink(missing_ok=True)


def read_state(folder: Path, name: str, remedy: str) -> Any:
    """Read what `write_state` wrote, tensors on the CPU; CheckpointError says what is wrong, and `remedy`."""
    tree = read_json(folder / f"{name}.json", remedy)
    try:
        return unpack_tree(tree, _read_tensors(folder / f"{name}.safetensors", remedy))
    except (ValueError, SafetensorError) as error:
        raise CheckpointError(f"{folder / name} is damaged ({error}): {remedy}.") from error


def _read_tensors(file: Path, remedy: str) -> dict[str, Tensor]:
    with reading(file, remedy):
        try:
            return load_file(file) if file.exists() else {}
        except RuntimeError as error:  # it was replaced in between
            raise CheckpointError(f"{file} cannot be opened ({error}): {remedy}.") from error


class _Stateful(Protocol):
    def state_dict(self) -> dict[str, Any]: ...

    def load_state_dict(self, state_dict: dict[str, Any]) -> None: ...


class StateFiles:
    """TorchRL's `dumps` and `loads`, which write and read the state_dict as a run's checkpoint does.

    A base class of samplers, writers, storages and replay buffers: it stands before TorchRL's.
    """

    def dumps(self: _Stateful, path: str | Path) -> None:
        """Write `state_dict` into the folder `path`, over what was dumped there before."""
        Path(path).mkdir(parents=True, exist_ok=True)
        write_state(Path(path), _NAME, self.state_dict())

    def loads(self: _Stateful, path: str | Path) -> None:
        """Read what `dumps` wrote."""
        self.load_state_dict(read_state(Path(path), _NAME, "name a folder that dumps has written"))


def _separate(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """Tensors on the CPU, contiguous, none sharing memory with another (safetensors refuses that)."""
    seen: set[int] = set()
    separate = {}
    for name, tensor in tensors.items():
        tensor = tensor.cpu().contiguous()
        owner = tensor.untyped_storage().data_ptr()
        separate[name] = tensor.clone() if owner in seen else tensor
        seen.add(owner)
    return separate
