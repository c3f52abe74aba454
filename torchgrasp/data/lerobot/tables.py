"""Tables of parquet: tensors to Arrow's arrays, and back from files that anyone may have written."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchgrasp.data.lerobot.features import Feature
from torchgrasp.data.lerobot.pictures import encode_picture
from torchgrasp.errors import CheckpointError, ConfigError

# Bytes of frames that are read at once, and of a row group's column.
_BATCH_BYTES = 1 << 26
_MOST_BYTES = 1 << 31
_MOST_ROWS = 1 << 12
# What is read of a picture's file beyond the picture itself.
PICTURE_HEADER = 1 << 16
# Bytes of a value in memory by parquet's types; texts of any length have none.
_WIDTHS = {"BOOLEAN": 1, "INT32": 4, "FLOAT": 4, "INT64": 8, "DOUBLE": 8, "INT96": 12, "BYTE_ARRAY": 0}
_INDEX = 4
# Tells each text by the last one's beginning, so that few bytes become many.
_BY_PREFIX = "DELTA_BYTE_ARRAY"


def to_arrow(values: Tensor, feature: Feature) -> Any:
    """A column (T, *shape) as Arrow's array of T entries, as LeRobot stores that feature."""
    import pyarrow as pa

    if feature.picture is not None:
        files = [encode_picture(each, feature.picture) for each in values.contiguous()]
        kinds = [pa.field("bytes", pa.binary()), pa.field("path", pa.string())]
        return pa.StructArray.from_arrays(
            [pa.array(files, pa.binary()), pa.nulls(len(files), pa.string())], fields=kinds
        )
    stored = values.to(getattr(torch, feature.stored)).contiguous()
    array = pa.array(stored.reshape(-1).numpy())
    shape = feature.shape or (1,)
    if shape == (1,):
        return array
    if len(shape) == 1:
        return pa.FixedSizeListArray.from_arrays(array, shape[0])
    for axis in reversed(range(len(shape))):
        count = len(values) * math.prod(shape[:axis])
        offsets = pa.array(np.arange(count + 1, dtype=np.int32) * shape[axis])
        array = pa.ListArray.from_arrays(offsets, array)
    return array


@contextmanager
def opened(path: Path, remedy: str, **options: Any) -> Iterator[Any]:
    """The pyarrow ParquetFile at `path`; CheckpointError where what is read in the block is damaged."""
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, page_checksum_verification=True, **options) as file:
            yield file
    except (ConfigError, CheckpointError):
        raise
    except FileNotFoundError as error:
        raise CheckpointError(f"{path} is missing: {remedy}.") from error
    except Exception as error:  # Arrow raises what its C++ does
        reason = " ".join(str(error).split())[:200]
        raise CheckpointError(
            f"{path} cannot be read ({type(error).__name__}: {reason}): {remedy}."
        ) from error


def read_batches(
    path: Path,
    entries: Mapping[str, int],
    remedy: str,
    *,
    shared: Sequence[str] = (),
    most: int = _MOST_BYTES,
) -> Iterator[dict[str, Any]]:
    """Some rows after the other of the columns `entries` of a parquet file, as Arrow's arrays by name.

    What the file tells of itself is checked first, so that no more than some frames are in memory.

    Args:
        path: of the file.
        entries: column -> bytes that an entry may take in memory.
        remedy: for errors.
        shared: those of the columns that hold files or texts; see `from_shared`.
        most: bytes that a row group's column may take.
    """
    with opened(path, remedy) as file:
        present = set(file.schema_arrow.names)
        if lacking := [name for name in entries if name not in present]:
            raise ConfigError(f"{path} has no column {lacking}, which meta/info.json tells of: {remedy}.")
        leaves = _find_leaves(file.schema, entries, shared)
        metadata = file.metadata
        check = partial(_check_group, leaves=leaves, path=path, entries=entries, most=most, remedy=remedy)
        sizes = [check(metadata.row_group(number)) for number in range(metadata.num_row_groups)]
    columns = [leaf.path for leaf in leaves]
    once = [leaf.path for leaf in leaves if leaf.shared]
    with opened(path, remedy, metadata=metadata, read_dictionary=once) as file:
        # Arrow joins no entries that are told once over row groups.
        for number, size in enumerate(sizes):
            rows = min(_MOST_ROWS, _BATCH_BYTES // max(1, sum(entries.values())), _MOST_BYTES // size)
            for batch in file.iter_batches(batch_size=max(1, rows), row_groups=[number], columns=columns):
                yield {name: _plain(batch.column(name), name in shared) for name in entries}


class _Leaf(NamedTuple):
    """A column of numbers, files or texts of which an entry is made."""

    place: int
    path: str
    name: str  # of the entry
    width: int  # bytes of a value in memory, 0 where it may be as long as the column
    offsets: int  # bytes besides, of the lists that hold one value
    shared: bool


def _find_leaves(schema: Any, entries: Mapping[str, int], shared: Sequence[str]) -> list[_Leaf]:
    """What is read of a file: of the structs that hold a picture its bytes alone."""
    columns = [schema.column(place) for place in range(len(schema))]
    paths = [column.path for column in columns]
    leaves = []
    for place, column in enumerate(columns):
        above = (each for each in entries if f"{column.path}.".startswith(f"{each}."))
        name = max(above, key=len, default=None)
        if name is None or (name in shared and column.path != f"{name}.bytes" and f"{name}.bytes" in paths):
            continue
        once = (
            name in shared and column.physical_type == "BYTE_ARRAY" and column.path in (name, f"{name}.bytes")
        )
        width = _INDEX if once else _WIDTHS.get(column.physical_type, column.length or 0)
        offsets = _INDEX * column.max_repetition_level
        leaves.append(_Leaf(place, column.path, name, width, offsets, once))
    return leaves


def _check_group(
    group: Any, *, leaves: Sequence[_Leaf], path: Path, entries: Mapping[str, int], most: int, remedy: str
) -> int:
    """Refuse a row group that would take more memory than its frames; returns what one row may take.

    One row may hold all values of its group, and files tell values that are the same once.
    """
    total = 1
    for leaf in leaves:
        column, entry = group.column(leaf.place), entries[leaf.name]
        stored = column.total_uncompressed_size
        values = column.num_values * (leaf.width or stored)
        size = values + column.num_values * leaf.offsets
        # Numbers of one byte may be stored in eight.
        if (
            stored > min(most, group.num_rows * (2 * entry + PICTURE_HEADER) + PICTURE_HEADER)
            or values > group.num_rows * 8 * entry + PICTURE_HEADER
            or not 0 <= size <= most
            or stored < 0
        ):
            raise CheckpointError(
                f"{path}: {leaf.name!r} of {group.num_rows} frames would take {max(size, stored)} bytes or "
                f"more: {remedy}."
            )
        if leaf.shared and _BY_PREFIX in column.encodings:
            raise CheckpointError(
                f"{path}: {leaf.name!r} is stored by {_BY_PREFIX}, which is not read here: {remedy}."
            )
        total += size
    return total


def _plain(array: Any, shared: bool) -> Any:
    """The array in Arrow's own types: LeRobot's for arrays of several axes are their storage here."""
    array = array.storage if hasattr(array, "storage") else array
    return array.field("bytes") if shared and hasattr(array, "field") else array


def from_shared(array: Any, name: str, most: int) -> list[bytes | None]:
    """Files or texts (T) of an Arrow array; those that are the same are one object.

    ConfigError with `name` where there are none, or one of more than `most` bytes.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_null(array.type):
        return [None] * len(array)
    kind = array.type.value_type if pa.types.is_dictionary(array.type) else array.type
    binary = pa.types.is_binary(kind) or pa.types.is_large_binary(kind)
    text = pa.types.is_string(kind) or pa.types.is_large_string(kind)
    if not pa.types.is_dictionary(array.type) or not (binary or text):
        raise ConfigError(f"{name} holds {array.type}, no pictures as files or texts: mend the dataset.")
    used = array.indices.drop_null().unique()
    values = array.dictionary.take(used)
    longest = pc.max(pc.binary_length(values)).as_py() or 0  # pyright: ignore[reportAttributeAccessIssue]
    if longest > most:
        raise ConfigError(f"{name} has an entry of {longest} bytes, at most {most} fit: mend the dataset.")
    entries = dict(zip(used.to_pylist(), values.cast(pa.large_binary()).to_pylist(), strict=True))
    return [entries.get(number) for number in array.indices.to_pylist()]


def from_arrow(array: Any, name: str, shape: tuple[int, ...]) -> Any:
    """Numbers (T, *shape) of an Arrow array of lists; ConfigError with `name` where there are others."""
    import pyarrow as pa
    import pyarrow.compute as pc

    count = len(array)
    # One number a frame may be told as such, or as a list of one.
    for size in shape if shape != (1,) or _is_list(array.type) else ():
        if not _is_list(array.type):
            raise _other_shape(name, shape)
        lengths = pc.list_value_length(array)  # pyright: ignore[reportAttributeAccessIssue]
        if array.null_count or not pc.all(pc.equal(lengths, size)).as_py():  # pyright: ignore
            raise _other_shape(name, shape)
        array = array.flatten()
        array = array.storage if hasattr(array, "storage") else array
    kind = array.type
    numbers = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
    if not numbers or array.null_count or len(array) != count * math.prod(shape):
        raise _other_shape(name, shape)
    return array.to_numpy(zero_copy_only=False).reshape(count, *shape)


def _is_list(kind: Any) -> bool:
    import pyarrow as pa

    return pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)


def _other_shape(name: str, shape: tuple[int, ...]) -> ConfigError:
    return ConfigError(f"{name} holds no numbers of shape {shape} in each frame: mend the dataset.")
