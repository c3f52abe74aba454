"""Public ImageNet weights for a ResNet: from a safetensors file, never from a pickle."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from torchgrasp.errors import CheckpointError, ConfigError

_CONVERT = (
    "python -c \"import torch, safetensors.torch as s; s.save_file(torch.load('{path}', "
    "weights_only=True), '{new}')\""
)
# What a file may hold and the network lack: the classifier, and with GroupNorm BatchNorm's statistics.
_STATISTICS = ("running_mean", "running_var", "num_batches_tracked")
_FIRST = "conv1.weight"


def load_image_weights(network: nn.Module, path: Path) -> None:
    """Fill `network`, a ResNet, from the safetensors file `path` with torchvision's parameter names.

    The classifier `fc` is left out. Where the network has more input channels than the file, the
    further ones start at zero: at first the network sees what the file's did.
    """
    state, own = _read(path), network.state_dict()
    state = {name: value for name, value in state.items() if not name.startswith("fc.")}
    missing = [name for name in own if name not in state and not name.endswith("num_batches_tracked")]
    unknown = [name for name in state if name not in own and name.rsplit(".", 1)[-1] not in _STATISTICS]
    if missing or unknown:
        raise CheckpointError(
            f"{path} holds no weights of this network: it lacks {missing[:3]} and has {unknown[:3]} "
            "besides. Give those of a ResNet18 with torchvision's or timm's names."
        )
    state[_FIRST] = _widen(state[_FIRST], own[_FIRST])
    wrong = [name for name in own if name in state and state[name].shape != own[name].shape]
    if wrong:
        raise CheckpointError(
            f"{path}: {wrong[0]} has the shape {tuple(state[wrong[0]].shape)}, the network's has "
            f"{tuple(own[wrong[0]].shape)}: public weights need width=1 and at least their input channels."
        )
    network.load_state_dict({name: value for name, value in state.items() if name in own}, strict=False)


def _read(path: Path) -> dict[str, Tensor]:
    if path.suffix != ".safetensors":
        convert = _CONVERT.format(path=path, new=path.with_suffix(".safetensors").name)
        raise ConfigError(
            f"weights={path} is no .safetensors file, and other files may run code when they are read: "
            f"convert it once where you trust it, by {convert}"
        )
    if not path.is_file():
        raise CheckpointError(f"There is no weights file at {path}: give the path of a .safetensors file.")
    try:
        return load_file(path)
    except (SafetensorError, OSError, RuntimeError, ValueError) as error:
        raise CheckpointError(f"{path} is damaged ({error}): get the file again.") from error


def _widen(filters: Tensor, wanted: Tensor) -> Tensor:
    """Filters (F, k, h, w) for as many channels as `wanted` has; the further ones are zero."""
    extra = wanted.shape[1] - filters.shape[1]
    if extra <= 0:
        return filters
    return torch.cat((filters, filters.new_zeros(len(filters), extra, *filters.shape[2:])), dim=1)
