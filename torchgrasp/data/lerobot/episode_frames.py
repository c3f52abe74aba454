"""Episodes of a LeRobotDataset: read from its files frame by frame, and turned into rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from torchgrasp import keys
from torchgrasp.data.compact import default_labels
from torchgrasp.data.foreign_columns import check_end
from torchgrasp.data.lerobot.dataset_files import REMEDY
from torchgrasp.data.lerobot.features import Feature
from torchgrasp.data.lerobot.pictures import decode_pictures
from torchgrasp.data.lerobot.tables import PICTURE_HEADER, from_arrow, from_shared, read_batches
from torchgrasp.data.sampler import STUB
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.geometry import ACTION_SIZE

_COUNTED = ("episode_index", "frame_index", "task_index")
_MOST_BYTES = 1 << 31
_FLAGS = ("terminated", "done", keys.EPISODE_SUCCESS)


@dataclass
class Frames:
    """Frames (T) of one episode.

    Attributes:
        number: of the episode.
        task: number of its task.
        columns: of each feature; pictures are files yet.
        counts: frame_index of each frame.
        held: bytes of the pictures' files.
    """

    number: int
    task: int
    columns: dict[str, list[Any]] = field(default_factory=dict)
    counts: list[Any] = field(default_factory=list)
    held: int = 0

    def __len__(self) -> int:
        return sum(map(len, self.counts))

    def tensor(self, feature: Feature, unit: str | None = None) -> Tensor:
        """A feature's values (T, *shape), of its column's type."""
        told, pieces = f"Episode {self.number}: {feature.name!r}", self.columns[feature.name]
        if feature.picture is not None:
            files = [file for piece in pieces for file in piece]
            return decode_pictures(files, told, feature.picture, shape=feature.shape, unit=unit)
        values = torch.from_numpy(self.numbers(feature)).to(feature.dtype)
        return values.reshape(len(values), *feature.shape)

    def numbers(self, feature: Feature) -> Any:
        """Numbers (T, *shape) as they are stored; a column of (T) as (T, 1)."""
        return np.concatenate(self.columns[feature.name])


def read_frames(files: Sequence[Path], features: Sequence[Feature]) -> Iterator[Frames]:
    """Each episode's frames, in the order in which they lie in the files."""
    entries = {feature.name: max(feature.bytes, 1) for feature in features} | dict.fromkeys(_COUNTED, 8)
    pictures = [feature.name for feature in features if feature.picture is not None]
    current: Frames | None = None
    for file in files:
        for batch in read_batches(file, entries, REMEDY, shared=pictures):
            counted = {name: from_arrow(batch[name], f"{file}: {name!r}", (1,))[:, 0] for name in _COUNTED}
            numbers = counted["episode_index"]
            starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
            for start, stop in pairwise(starts):
                if current is None or current.number != numbers[start]:
                    if current is not None:
                        yield current
                    current = Frames(int(numbers[start]), int(counted["task_index"][start]))
                _add(current, batch, counted["frame_index"], features, slice(start, stop))
    if current is not None:
        yield current


def _add(
    frames: Frames, batch: Mapping[str, Any], counts: Any, features: Sequence[Feature], part: slice
) -> None:
    """Put a part of a batch to the frames of its episode."""
    frames.counts.append(counts[part])
    _check_memory(frames, features)
    for feature in features:
        array = batch[feature.name].slice(part.start, part.stop - part.start)
        told = f"Episode {frames.number}: {feature.name!r}"
        if feature.picture is not None:
            values = from_shared(array, told, 2 * feature.bytes + PICTURE_HEADER)
            frames.held += sum(len(file) for file in values if file)
            _check_memory(frames, features)
        else:
            values = from_arrow(array, told, feature.shape or (1,))
        frames.columns.setdefault(feature.name, []).append(values)


def _check_memory(frames: Frames, features: Sequence[Feature]) -> None:
    """Refuse an episode whose pictures' files, and what they and numbers become, take too much."""
    if len(frames) * sum(feature.bytes for feature in features) + frames.held > _MOST_BYTES:
        raise CheckpointError(f"Episode {frames.number} takes more than {_MOST_BYTES} bytes: {REMEDY}.")


def check_frames(frames: Frames, number: int, length: int, *, first: int = 0) -> None:
    """CheckpointError unless these are `length` frames of episode `number`, in order from `first` on."""
    counts = np.concatenate(frames.counts)
    expected = np.arange(first, first + length)
    if frames.number != number or len(counts) != length or (counts != expected).any():
        raise CheckpointError(
            f"There are {len(counts)} frames of episode {frames.number}, or in another order, where "
            f"meta/episodes tells of {length} of episode {number}: {REMEDY}."
        )


def frames_to_rows(frames: Frames, last: Frames | None, features: Sequence[Feature]) -> TensorDict:
    """Rows (R) of an export's episode, as they were; `last` holds the observation that was cut off."""
    num_rows = len(frames) + (last is not None)
    rows = TensorDict({}, [num_rows])
    for feature in features:
        values = frames.tensor(feature)
        rows[feature.key] = values if last is None else torch.cat((values, last.tensor(feature)))
    _check_rows(rows, frames)
    return rows.set(STUB, (torch.arange(num_rows) >= len(frames))[:, None])


def _check_rows(rows: TensorDict, frames: Frames) -> None:
    """Refuse an export that lacks what every row has, or whose episode ends elsewhere than at its end."""
    expected = {**default_labels(), **{key: torch.zeros(1, dtype=torch.bool) for key in _FLAGS}}
    expected |= {keys.ACTION: torch.zeros(ACTION_SIZE), "reward": torch.zeros(1)}
    for key, each in expected.items():
        found = rows.get(key, None)
        if (
            found is None
            or found.dtype != each.dtype
            or (found.shape[1:] != each.shape and key != keys.ACTION)
        ):
            told = None if found is None else (found.dtype, tuple(found.shape[1:]))
            raise ConfigError(
                f"Episode {frames.number} has {key!r} of {told}, demonstrations have it of {each.dtype} and "
                f"shape {tuple(each.shape)}: {REMEDY}."
            )
    done: Any = rows["done"][: len(frames)]
    check_end(done, f"Episode {frames.number}: 'next.done'")
    if not bool(done[-1]):
        raise ConfigError(f"Episode {frames.number}: 'next.done' is false at its last step: {REMEDY}.")
