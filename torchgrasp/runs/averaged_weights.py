"""One policy of several that were trained on from one another, or from one start: the mean of weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchgrasp.errors import ConfigError
from torchgrasp.runs.weights import load_weights, save_weights

# What a run's own configuration says of files: of no meaning for those who get the weights.
_OF_ONE_RUN = {"resume": None, "init": None, "output_dir": "outputs"}
_REMEDY = "give policies that were trained on from one another."
Loaded = tuple[Mapping[str, Mapping[str, Tensor]], dict[str, Any]]  # state_dicts by network, configuration


def average_weights(
    paths: Sequence[Path],
    output: Path,
    *,
    mirrored: bool = False,
    load: Callable[[Path], Loaded] = load_weights,
) -> list[str]:
    """Write the mean of the weights files `paths` to `output`; returns the names of the networks in it.

    Networks that were trained on from the same weights lie in one basin: the mean of their weights often
    does better than each of them and costs no more than one (Wortsman et al. 2022, "Model soups"). The mean
    of networks from different beginnings is of no use. Networks that not all files hold are left out; the
    configuration is that of the first file, without what it says of its run.

    Args:
        paths: files of `save_weights`; the mean of one is that one.
        output: the file to write, whole or not at all.
        mirrored: have the policy act by the mean over reflections as well (`modules.MirroredPolicy`).
        load: gives what a file holds.

    Raises:
        ConfigError: for no files, no network in common, or networks of different shapes.
        CheckpointError: where a file cannot be read.
    """
    if not paths:
        raise ConfigError("There is no policy to average: give one or more.")
    (first, config), *others = [load(path) for path in paths]
    names = [name for name in first if all(name in states for states, _ in others)]
    if not names:
        raise ConfigError(f"{paths[0]} and the others have no network in common: give policies alike.")
    for path, (states, _) in zip(paths[1:], others, strict=True):
        for name in names:
            _check_alike(name, first[name], states[name], paths[0], path)
    means = {
        name: {
            key: _mean([value, *(states[name][key] for states, _ in others)])
            for key, value in first[name].items()
        }
        for name in names
    }
    config = config | {key: value for key, value in _OF_ONE_RUN.items() if key in config}
    if mirrored:
        config["model"] = {**config["model"], "mirrored": True}
    save_weights(output, means, config)
    return names


def _check_alike(
    name: str, ours: Mapping[str, Tensor], theirs: Mapping[str, Tensor], our_path: Path, path: Path
) -> None:
    one, other = ({key: (value.shape, value.dtype) for key, value in each.items()} for each in (ours, theirs))
    differing = sorted(key for key in {*one, *other} if one.get(key) != other.get(key))
    if differing:
        raise ConfigError(
            f"The {name} of {path} is built otherwise than that of {our_path} ({differing[0]} is the first "
            f"of {len(differing)} differences): {_REMEDY}"
        )


def _mean(values: Sequence[Tensor]) -> Tensor:
    """The mean of tensors of one shape; of counters and the like, which are whole, the first."""
    if not values[0].is_floating_point():
        return values[0]
    return torch.stack(list(values)).mean(dim=0)
