"""The files of a LeRobotDataset v3, which anyone may have written: what they tell is checked as it is read.

meta/info.json                                  version, counts, fps, features
meta/stats.json                                 statistics of features over all frames
meta/tasks.parquet                              task_index and text, here the objects' names
meta/episodes/chunk-000/file-000.parquet        an episode a row: its length, task, place, statistics
data/chunk-000/file-000.parquet                 a frame a row, one row group an episode
meta/torchgrasp.json                            of exports: the card, and each feature's column
meta/torchgrasp_last.parquet                    of exports: the last observation of truncated episodes
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, JsonValue

from torchgrasp.data.demonstration_card import Card
from torchgrasp.data.lerobot.features import COUNTERS, Column
from torchgrasp.data.lerobot.tables import from_arrow, from_shared, opened, read_batches
from torchgrasp.documents import Amount, Count, Document, Name, OpenDocument, check_document, read_document
from torchgrasp.errors import CheckpointError, ConfigError

REMEDY = "get the dataset again"
VERSION = "v3.0"
FIRST_FILE = "chunk-000/file-000.parquet"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
LAST = "meta/torchgrasp_last.parquet"
# pandas keeps the texts of tasks as its index, by this name where it has none.
TASK_COLUMNS = ("task", "__index_level_0__")
_EXPORT = "meta/torchgrasp.json"
_MAX_TEXT = 1 << 12  # bytes of a task
_MOST_TEXT = 1 << 26  # of all tasks
# Episodes, and tasks, that are read of a dataset.
_MOST_EPISODES = 1 << 18


class FeatureInfo(OpenDocument):
    """What meta/info.json tells of a feature."""

    dtype: Name
    shape: Annotated[list[Count], Field(max_length=16)]
    names: JsonValue = None
    info: JsonValue = None


class Info(OpenDocument):
    """meta/info.json."""

    codebase_version: Name
    fps: Annotated[Amount, Field(gt=0)]
    total_episodes: Count
    total_frames: Count
    features: dict[Name, FeatureInfo]


class Export(Document):
    """meta/torchgrasp.json: what an export tells besides, for its way back."""

    format: Literal[1]
    frames: Count
    card: Card
    columns: dict[Name, Column]


@dataclass(frozen=True)
class DatasetFiles:
    """A LeRobotDataset on disk.

    Attributes:
        folder: of the dataset.
        info: meta/info.json.
        export: meta/torchgrasp.json, where an export wrote it.
        tasks: the text of each task.
        lengths: frames of each episode.
        seeds: of each episode, 0 where none is told.
    """

    folder: Path
    info: Info
    export: Export | None
    tasks: dict[int, str]
    lengths: list[int]
    seeds: list[int]

    @property
    def data(self) -> list[Path]:
        """The files of frames, in order."""
        return sorted(self.folder.glob("data/*/*.parquet"))


def read_dataset(folder: Path) -> DatasetFiles:
    """What the dataset in `folder` tells of itself; no frame is read yet."""
    if not (folder / "meta" / "info.json").exists():
        raise CheckpointError(
            f"There is no LeRobotDataset at {folder}: name the folder that holds meta/info.json."
        )
    info = read_document(folder / "meta" / "info.json", Info, REMEDY)
    if not info.codebase_version.startswith("v3."):
        raise ConfigError(
            f"{folder} is a LeRobotDataset of version {info.codebase_version}, {VERSION} is read here: "
            "convert it by LeRobot's script for that."
        )
    if not info.total_episodes or not info.total_frames:
        raise ConfigError(f"{folder} holds no episode: there is nothing to import.")
    if info.total_episodes > _MOST_EPISODES:
        raise ConfigError(
            f"{folder} tells of {info.total_episodes} episodes, at most {_MOST_EPISODES} are read: split it."
        )
    export = _read_export(folder, info)
    lengths, seeds = _read_episodes(folder, info, seeded=export is not None)
    return DatasetFiles(folder, info, export, _read_tasks(folder, info), lengths, seeds)


def _read_export(folder: Path, info: Info) -> Export | None:
    file = folder / _EXPORT
    if not file.exists():
        return None
    export = read_document(file, Export, REMEDY)
    if export.frames != info.total_frames:
        raise ConfigError(
            f"{file} tells of {export.frames} frames, meta/info.json of {info.total_frames}: where the "
            "dataset was changed since it was exported, delete the former."
        )
    if lacking := sorted(export.columns.keys() - info.features.keys()):
        raise ConfigError(f"{file} tells of {lacking}, which meta/info.json does not: {REMEDY}.")
    found = [tuple(column.key) for column in export.columns.values()]
    above = {key[:length] for key in found for length in range(1, len(key))}
    if len(set(found)) < len(found) or above & set(found):
        raise ConfigError(f"{file} tells of two features as one column: {REMEDY}.")
    return export


def write_export(folder: Path, frames: int, card: dict[str, Any], columns: dict[str, Any]) -> None:
    """Write meta/torchgrasp.json."""
    told = {"format": 1, "frames": frames, "card": card, "columns": columns}
    export = check_document(told, Export, folder / _EXPORT, "give other demonstrations")
    (folder / _EXPORT).write_text(json.dumps(export.model_dump(), indent=4) + "\n")


def _read_episodes(folder: Path, info: Info, *, seeded: bool) -> tuple[list[int], list[int]]:
    """Length and seed of each episode."""
    where, names = folder / "meta" / "episodes", ["episode_index", "length", *(["seed"] if seeded else [])]
    table: dict[str, list[int]] = {name: [] for name in names}
    for file in sorted(where.glob("*/*.parquet")):
        for batch in read_batches(file, dict.fromkeys(names, 8), REMEDY):
            found = {
                name: from_arrow(array, f"{file}: {name!r}", (1,))[:, 0] for name, array in batch.items()
            }
            numbers, count = found["episode_index"], len(table["length"])
            expected = np.arange(count, count + len(numbers))
            if count + len(numbers) > info.total_episodes or (numbers != expected).any():
                raise CheckpointError(
                    f"{where} tells of more episodes than the {info.total_episodes} of meta/info.json, or in "
                    f"another order: {REMEDY}."
                )
            for name, values in found.items():
                table[name] += values.tolist()
    lengths = table["length"]
    if len(lengths) != info.total_episodes:
        raise CheckpointError(
            f"{where} tells of {len(lengths)} episodes, meta/info.json of {info.total_episodes}: {REMEDY}."
        )
    if min(lengths) < 1 or sum(lengths) != info.total_frames:
        raise CheckpointError(
            f"{where} tells of {sum(lengths)} frames, meta/info.json of {info.total_frames}: {REMEDY}."
        )
    return lengths, table.get("seed", [0] * len(lengths))


def _read_tasks(folder: Path, info: Info) -> dict[int, str]:
    """The text of each task, by its number."""
    file = folder / "meta" / "tasks.parquet"
    with opened(file, REMEDY) as parquet:
        present = set(parquet.schema_arrow.names)
    column = next((name for name in TASK_COLUMNS if name in present), None)
    if column is None:
        raise CheckpointError(f"{file} has no column {TASK_COLUMNS[0]!r}: {REMEDY}.")
    tasks: dict[int, str] = {}
    entries, count, size = {column: _MAX_TEXT, "task_index": 8}, 0, 0
    for batch in read_batches(file, entries, REMEDY, shared=[column], most=_MOST_TEXT):
        numbers = from_arrow(batch["task_index"], f"{file}: 'task_index'", (1,))[:, 0].tolist()
        texts = from_shared(batch[column], f"{file}: {column!r}", _MAX_TEXT)
        count, size = count + len(numbers), size + sum(map(len, {text for text in texts if text}))
        if count > min(info.total_frames, _MOST_EPISODES) or size > _MOST_TEXT:
            raise CheckpointError(
                f"{file} tells of more tasks than the dataset has frames, than {_MOST_EPISODES}, or than "
                f"{_MOST_TEXT} bytes of them: {REMEDY}."
            )
        # What is the same is one text here, too.
        decoded = {text: (text or b"").decode(errors="replace") for text in set(texts)}
        tasks |= {number: decoded[text] or "unknown" for number, text in zip(numbers, texts, strict=True)}
    return tasks


def check_counters(info: Info) -> None:
    """ConfigError unless the dataset has the features that LeRobot writes into every one."""
    if lacking := [name for name in COUNTERS if name not in info.features]:
        raise ConfigError(f"meta/info.json tells of no {lacking}, which every LeRobotDataset has: {REMEDY}.")
