"""Weights by the name that an option gives them, with the configuration that they bring along."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from torchgrasp.config.lenses import name_lenses
from torchgrasp.config.part_kinds import check_parts, check_strangers_parts
from torchgrasp.config.schema import Brought
from torchgrasp.config.value_checks import check_section
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import PRETRAINED, load_weights

# What is taken over from a file; the rest of its configuration is not looked at.
_TAKEN = (
    "recipe",
    "num_points",
    "env",
    "camera",
    "overhead",
    "transforms",
    "model",
    "replay",
    "demonstrations",
)


@dataclass(frozen=True)
class TrainedWeights:
    """A weights file as it was read: data, of which `config` names only classes that may be built.

    Attributes:
        path: the run directory or file that was named.
        states: state_dicts by network.
        config: how the networks, their observations and their task are rebuilt, as plain values.
    """

    path: Path
    states: Mapping[str, Mapping[str, Tensor]]
    config: dict[str, Any]


def weights_file(path: Path) -> Path:
    """The weights of a run directory, the file itself, or what comes with the library as `pretrained`."""
    if str(path) == "pretrained":
        return PRETRAINED
    return path / "weights.safetensors" if path.is_dir() else path


def check_weights(option: str, name: str, *others: str) -> None:
    """Refuse what names no weights; `others` are names that the option takes besides."""
    path = Path(name)
    try:
        folder, there = path.is_dir(), weights_file(path).is_file()
    except OSError as error:  # a name that is too long
        raise ConfigError(f"{option}={name[:100]!r}... cannot be a path ({error.strerror}).") from error
    if folder and not there:
        raise ConfigError(
            f"{option}={name!r} holds no weights.safetensors: give the run directory of a training that has "
            "saved its first checkpoint."
        )
    if not there:
        choices = ", ".join((*others, "pretrained", "a run directory"))
        raise ConfigError(f"{option}={name!r} is not there: give {choices} or a weights file.")


def read_trained(path: Path, trust: Iterable[str] = ()) -> TrainedWeights:
    """The weights of a run directory or file, and what they bring along; nothing is built yet.

    Args:
        path: a run directory, a file of `torchgrasp.runs.save_weights`, or ``pretrained``.
        trust: packages besides torchgrasp and TorchRL whose classes the configuration may name.

    Raises:
        CheckpointError: where the file is damaged, or tells too little to rebuild the networks.
        ConfigError: where its configuration names what it may not.
    """
    file = weights_file(path)
    states, config = load_weights(file)
    config = {name: value for name, value in config.items() if name in _TAKEN}
    check_strangers_parts(config, str(file), trust)
    try:
        check_section("", config, Brought)
        check_parts(config)
    except ConfigError as error:
        raise CheckpointError(f"{file} has a configuration of no recipe: {error}") from error
    return TrainedWeights(path, states, name_lenses(config))
