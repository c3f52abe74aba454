"""The files of Minari datasets, which anyone may have written: looked through before Minari opens them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

from torchgrasp.data.demonstration_card import Card
from torchgrasp.documents import Count, OpenDocument, Text, parse_json, read_document, shorten
from torchgrasp.errors import CheckpointError, ConfigError

REMEDY = "get the dataset again"
# Where the card of the demonstrations stands in Minari's metadata.
CARD = "torchgrasp"
_MAX_DEPTH = 12
# Deflate makes text of one byte over and over 1,032 times shorter, and never more.
_MAX_RATIO = 1100
_MAX_BYTES = 1 << 31


class Metadata(OpenDocument):
    """metadata.json of a dataset; spaces are JSON of their own, `torchgrasp` the card of an export."""

    total_episodes: Count
    total_steps: Count
    data_format: Literal["hdf5"]
    observation_space: Text
    action_space: Text
    torchgrasp: Card | None = None


def read_metadata(data: Path) -> Metadata:
    """What metadata.json in the folder `data` tells.

    Minari would make an environment of the `env_spec` where a space is missing, and run what that names:
    datasets without spaces are refused.
    """
    file = data / "metadata.json"
    metadata = read_document(file, Metadata, REMEDY)
    for name in ("observation_space", "action_space"):
        _check_space(parse_json(getattr(metadata, name), f"{file}: {name}", REMEDY), f"{file}: {name}")
    return metadata


def _check_space(space: Any, source: str) -> None:
    """Refuse boxes whose bounds are told for a few of their numbers: they would be spread over all."""
    if not isinstance(space, dict):
        raise CheckpointError(f"{source} is {shorten(space)}, no space: {REMEDY}.")
    parts = space.get("subspaces", ())
    for each in parts.values() if isinstance(parts, dict) else parts if isinstance(parts, list) else ():
        _check_space(each, source)
    bounds = (space.get("low"), space.get("high"))
    if space.get("type") == "Box" and any(_shape(each) != space.get("shape") for each in bounds):
        raise CheckpointError(f"{source} is {shorten(space)}, whose bounds have another shape: {REMEDY}.")


def _shape(values: Any) -> list[int]:
    """How long nested lists are."""
    shape = []
    while isinstance(values, list):
        shape.append(len(values))
        values = values[0] if values else None
    return shape


def check_hdf5(data: Path, num_episodes: int) -> None:
    """Refuse a file of other episodes, with links to elsewhere, or arrays that it does not hold.

    A file of a few kilobytes can tell of arrays of terabytes, and of others' files as its own.
    """
    import h5py

    path = data / "main_data.hdf5"
    try:
        with h5py.File(path, "r") as file:
            names = {f"episode_{number}" for number in range(min(num_episodes, len(file) + 1))}
            if len(file) != num_episodes or set(file) != names:
                raise CheckpointError(
                    f"{path} holds {len(file)} episodes, metadata.json tells of {num_episodes}: {REMEDY}."
                )
            _check_group(file, path, set(), 0)
    except (ConfigError, CheckpointError):
        raise
    except Exception as error:  # HDF5 raises what its library does
        raise CheckpointError(
            f"{path} cannot be read ({type(error).__name__}: {error}): {REMEDY}."
        ) from error


def _check_group(group: Any, path: Path, seen: set[Any], depth: int) -> None:
    import h5py

    for name in group:
        place = f"{path}: {group.name}/{name}"
        link = group.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink):
            raise ConfigError(f"{place} is a link to elsewhere, which could be any file: {REMEDY} without.")
        part = group[name]
        address = h5py.h5o.get_info(part.id).addr  # pyright: ignore[reportAttributeAccessIssue]
        if address in seen or depth > _MAX_DEPTH:
            raise CheckpointError(f"{place} is there under another name, too, or too deep: {REMEDY}.")
        seen.add(address)
        if isinstance(part, h5py.Group):
            _check_group(part, path, seen, depth + 1)
        elif isinstance(part, h5py.Dataset):
            _check_array(part, place)
        else:
            raise CheckpointError(f"{place} is neither a group nor an array: {REMEDY}.")


def _check_array(array: Any, place: str) -> None:
    if array.external or array.is_virtual:
        raise ConfigError(f"{place} lies in other files, which could be any: {REMEDY} without.")
    if array.dtype.kind == "O":
        raise ConfigError(f"{place} holds values of any length: leave it out of the dataset.")
    size, stored = math.prod(array.shape or (0,)) * array.dtype.itemsize, array.id.get_storage_size()
    if size > min(_MAX_BYTES, _MAX_RATIO * stored):
        raise CheckpointError(
            f"{place} of shape {shorten(array.shape)} would take {size} bytes, {stored} are stored: {REMEDY}."
        )
