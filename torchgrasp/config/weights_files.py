"""Weights by the name that an option gives them, and the configuration that they bring along."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchgrasp.errors import ConfigError
from torchgrasp.runs import PRETRAINED, load_weights


def weights_file(path: Path) -> Path:
    """The weights of a run directory, the file itself, or what comes with the library as `pretrained`."""
    if str(path) == "pretrained":
        return PRETRAINED
    return path / "weights.safetensors" if path.is_dir() else path


def check_weights(option: str, name: str, *others: str) -> None:
    """Refuse what names no weights; `others` are names that the option takes besides."""
    path = Path(name)
    if path.is_dir() and not weights_file(path).is_file():
        raise ConfigError(
            f"{option}={name!r} holds no weights.safetensors: give the run directory of a training that has "
            "saved its first checkpoint."
        )
    if not weights_file(path).is_file():
        choices = ", ".join((*others, "pretrained", "a run directory"))
        raise ConfigError(f"{option}={name!r} is not there: give {choices} or a weights file.")


def brought_along(policy: Path, trusted: list[str]) -> dict[str, Any]:
    """The configuration in a policy's weights, whose classes are of torchgrasp, torchrl or `trusted`."""
    brought = load_weights(weights_file(policy))[1]
    _check_targets(brought, trusted)
    return brought


def _check_targets(config: Any, trusted: list[str]) -> None:
    """Refuse classes of packages that a weights file names and nobody vouches for."""
    allowed = ("torchgrasp", "torchrl", *trusted)
    if isinstance(config, dict):
        target = config.get("_target_")
        if target is not None and str(target).split(".")[0] not in allowed:
            raise ConfigError(
                f"The weights name the class {target}, which could run anything: if you know where they come "
                f"from, add trust=[{str(target).split('.')[0]}]."
            )
        config = list(config.values())
    for each in config if isinstance(config, list) else ():
        _check_targets(each, trusted)
