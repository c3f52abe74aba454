"""DatasetWriter: the files of a LeRobotDataset, episode by episode."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from torchgrasp.data.lerobot.dataset_files import (
    DATA_PATH,
    FIRST_FILE,
    LAST,
    TASK_COLUMNS,
    VERSION,
    write_export,
)
from torchgrasp.data.lerobot.features import COUNTERS, Feature
from torchgrasp.data.lerobot.frame_statistics import (
    Statistics,
    join_statistics,
    list_statistics,
    measure_frames,
)
from torchgrasp.data.lerobot.tables import to_arrow
from torchgrasp.data.sampler import STUB

# A control step lasts 0.15 s (docs/concepts.md).
_PERIOD = 0.15
_ROBOT = "panda"
# LeRobot's own: how large a file of frames grows, and how many lie in a folder.
_FILE_BYTES = 100 << 20
_FILES = 1000


class DatasetWriter:
    """Writes a LeRobotDataset into an empty folder; a context manager that closes its files.

    Args:
        folder: is there and empty.
        features: of each frame.
    """

    def __init__(self, folder: Path, features: Sequence[Feature]) -> None:
        self._folder, self._features = folder, list(features)
        self._files = ExitStack()
        self._data: Any = None
        self._last: Any = None
        self._number = -1  # of the file of frames
        self._frames = 0
        self._tasks: dict[str, int] = {}
        self._episodes: list[dict[str, Any]] = []
        self._statistics: Statistics = {}

    def __enter__(self) -> DatasetWriter:
        return self

    def __exit__(self, *reason: object) -> None:
        self._files.close()

    def add(self, rows: TensorDictBase, *, task: str, seed: int) -> None:
        """Write an episode, encoded rows (R); what a truncated one observed last goes beside the frames."""
        truncated = bool(rows[STUB][-1])
        steps = rows[:-1] if truncated else rows
        number = self._tasks.setdefault(task, len(self._tasks))
        table = self._make_table(steps, number, 0)
        path = self._write(table)
        if truncated:
            last = self._make_table(rows[-1:], number, len(steps))
            self._last = self._last or self._open(LAST, last.schema)
            self._last.write_table(last)
        measured = measure_frames(steps, self._features)
        self._statistics = join_statistics(self._statistics, measured) if self._statistics else measured
        self._episodes.append(
            {
                "episode_index": len(self._episodes),
                "tasks": [task],
                "length": len(steps),
                "data/chunk_index": path[0],
                "data/file_index": path[1],
                "dataset_from_index": self._frames,
                "dataset_to_index": self._frames + len(steps),
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "seed": seed,
                **_flatten(list_statistics(measured)),
            }
        )
        self._frames += len(steps)

    def _make_table(self, rows: TensorDictBase, task: int, first: int) -> Any:
        """Rows (R) as frames, numbered from `first` on in the episode."""
        import pyarrow as pa

        count = np.arange(first, first + len(rows))
        counters = {
            "timestamp": count * _PERIOD,
            "frame_index": count,
            "episode_index": np.full(len(rows), len(self._episodes)),
            "index": count + self._frames,
            "task_index": np.full(len(rows), task),
        }
        columns = {feature.name: to_arrow(rows[feature.key], feature) for feature in self._features}
        columns |= {name: pa.array(counters[name].astype(kind)) for name, kind in COUNTERS.items()}
        return pa.table(columns, metadata={"huggingface": _tell_types(self._features)})

    def _write(self, table: Any) -> tuple[int, int]:
        """Write the frames of an episode as one row group; returns the place of its file."""
        if self._data is None or self._path().stat().st_size > _FILE_BYTES:
            if self._data is not None:
                self._data.close()
            self._number += 1
            self._data = self._open(self._path().relative_to(self._folder), table.schema)
        self._data.write_table(table, row_group_size=max(1, len(table)))
        return divmod(self._number, _FILES)

    def _path(self) -> Path:
        chunk, file = divmod(max(self._number, 0), _FILES)
        return self._folder / DATA_PATH.format(chunk_index=chunk, file_index=file)

    def _open(self, name: str | Path, schema: Any) -> Any:
        import pyarrow.parquet as pq

        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = pq.ParquetWriter(path, schema, compression="zstd", write_page_checksum=True)
        return self._files.enter_context(writer)

    def finish(self, card: dict[str, Any]) -> None:
        """Write what tells of all frames, and close the files."""
        self._write_episodes()
        self._write_tasks()
        self._files.close()
        counters = {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in COUNTERS.items()}
        info = {
            "codebase_version": VERSION,
            "robot_type": _ROBOT,
            "total_episodes": len(self._episodes),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": _FILES,
            "data_files_size_in_mb": _FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": 1 / _PERIOD,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA_PATH,
            "video_path": None,
            "features": {feature.name: feature.describe() for feature in self._features} | counters,
        }
        self._write_json("info", info)
        self._write_json("stats", list_statistics(self._statistics))
        write_export(
            self._folder, self._frames, card, {feature.name: feature.tell() for feature in self._features}
        )

    def _write_json(self, name: str, value: Mapping[str, Any]) -> None:
        (self._folder / "meta" / f"{name}.json").write_text(json.dumps(value, indent=4) + "\n")

    def _write_episodes(self) -> None:
        import pyarrow as pa

        table = pa.Table.from_pylist(self._episodes)
        self._open(f"meta/episodes/{FIRST_FILE}", table.schema).write_table(table)

    def _write_tasks(self) -> None:
        """Tasks as pandas would, its index being the texts."""
        import pyarrow as pa

        text = TASK_COLUMNS[0]
        told = {name: {"name": name, "field_name": name, "metadata": None} for name in ("task_index", text)}
        told["task_index"] |= {"pandas_type": "int64", "numpy_type": "int64"}
        told[text] |= {"pandas_type": "unicode", "numpy_type": "object"}
        index = {"index_columns": [text], "column_indexes": [], "columns": list(told.values())}
        table = pa.table(
            {
                "task_index": pa.array(self._tasks.values(), pa.int64()),
                text: pa.array(self._tasks, pa.string()),
            },
            metadata={"pandas": json.dumps(index)},
        )
        self._open("meta/tasks.parquet", table.schema).write_table(table)


def _flatten(statistics: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics by the names of their columns."""
    return {f"stats/{name}/{key}": value for name, told in statistics.items() for key, value in told.items()}


def _tell_types(features: Sequence[Feature]) -> str:
    """How Hugging Face's `datasets` tells of pictures and arrays, for its readers besides LeRobot."""
    kinds: dict[str, Any] = {}
    for feature in features:
        value = {"dtype": feature.stored, "_type": "Value"}
        if feature.picture is not None:
            kinds[feature.name] = {"_type": "Image"}
        elif len(feature.shape) > 1:
            kinds[feature.name] = {
                "shape": list(feature.shape),
                "dtype": feature.stored,
                "_type": f"Array{len(feature.shape)}D",
            }
        elif feature.shape and feature.shape[0] != 1:
            kinds[feature.name] = {"feature": value, "length": feature.shape[0], "_type": "List"}
        else:
            kinds[feature.name] = value
    kinds |= {name: {"dtype": kind, "_type": "Value"} for name, kind in COUNTERS.items()}
    return json.dumps({"info": {"features": kinds}})
