"""Tables of parquet: tensors to Arrow's arrays, and back from files that anyone may have written."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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
_PICTURE_HEADER = 1 << 16


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
def opened(path: Path, remedy: str) -> Iterator[Any]:
    """The pyarrow ParquetFile at `path`; CheckpointError where what is read in the block is damaged."""
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
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
    path: Path, entries: Mapping[str, int], remedy: str, *, pictures: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Some rows after the other of the columns `entries` of a parquet file, as Arrow's arrays by name.

    What the file tells of itself is checked first, so that no more than some frames are in memory.

    Args:
        path: of the file.
        entries: column -> bytes that an entry may take in memory.
        remedy: for errors.
        pictures: those of the columns that hold files.
    """
    with opened(path, remedy) as file:
        present = set(file.schema_arrow.names)
        if lacking := [name for name in entries if name not in present]:
            raise ConfigError(f"{path} has no column {lacking}, which meta/info.json tells of: {remedy}.")
        largest = _check_groups(file, path, entries, remedy)
        rows = min(_MOST_ROWS, _BATCH_BYTES // max(1, sum(entries.values())), _MOST_BYTES // largest)
        for batch in file.iter_batches(batch_size=max(1, rows), columns=list(entries)):
            columns = {name: batch.column(name) for name in entries}
            yield {name: _plain(array, name in pictures) for name, array in columns.items()}


def _check_groups(file: Any, path: Path, entries: Mapping[str, int], remedy: str) -> int:
    """Refuse row groups that would take more memory than their frames; returns the largest column's bytes.

    So large may each entry of that column be: files tell an entry that many frames share once.
    """
    largest = 1
    for number in range(file.metadata.num_row_groups):
        group = file.metadata.row_group(number)
        for place in range(group.num_columns):
            column = group.column(place)
            place_in_schema = f"{column.path_in_schema}."
            name = max(
                (each for each in entries if place_in_schema.startswith(f"{each}.")), key=len, default=""
            )
            if not name:
                continue
            most = group.num_rows * (2 * entries[name] + _PICTURE_HEADER) + _PICTURE_HEADER
            size = max(column.total_uncompressed_size, column.num_values)
            if column.total_uncompressed_size > min(_MOST_BYTES, most) or column.num_values > most:
                raise CheckpointError(
                    f"{path}: {name!r} of {group.num_rows} frames would take {size} bytes or more: {remedy}."
                )
            largest = max(largest, size)
    return largest


def _plain(array: Any, picture: bool) -> Any:
    """The array in Arrow's own types: LeRobot's for arrays of several axes are their storage here."""
    array = array.storage if hasattr(array, "storage") else array
    return array.field("bytes") if picture and hasattr(array, "field") else array


def from_arrow(array: Any, name: str, shape: tuple[int, ...]) -> Any:
    """Numbers (T, *shape) of an Arrow array of lists; ConfigError with `name` where there are others."""
    import pyarrow as pa
    import pyarrow.compute as pc

    count = len(array)
    for size in shape if shape != (1,) else ():
        if not _is_list(array.type):
            raise _other_shape(name, shape)
        lengths = pc.list_value_length(array)  # pyright: ignore[reportAttributeAccessIssue]
        if array.null_count or not pc.all(pc.equal(lengths, size)).as_py():  # pyright: ignore
            raise _other_shape(name, shape)
        array = array.flatten()
        array = array.storage if hasattr(array, "storage") else array
    if shape == (1,) and _is_list(array.type):
        return from_arrow(array, name, (1, 1))[:, 0]
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
