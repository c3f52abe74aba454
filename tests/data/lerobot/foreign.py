"""LeRobotDatasets as others would write them: the fewest files, by pyarrow alone."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np

LENGTHS = (3, 5)
COUNTERS = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def draw_frames(seed: int = 0) -> dict:
    """Columns of all frames: what a dataset of clouds has."""
    generator, total = np.random.default_rng(seed), sum(LENGTHS)
    ends = np.cumsum(LENGTHS) - 1
    return {
        "observation.points": generator.random((total, 20, 3), np.float32),
        "action": generator.random((total, 6), np.float32),
        "next.reward": np.isin(np.arange(total), ends[:1]).astype(np.float32),
        "frame_index": np.concatenate([np.arange(length) for length in LENGTHS]),
        "episode_index": np.repeat(np.arange(len(LENGTHS)), LENGTHS),
        "timestamp": np.arange(total, dtype=np.float32) / 10,
        "index": np.arange(total),
        "task_index": np.repeat(np.arange(len(LENGTHS)) % 2, LENGTHS),
    }


def describe(columns: dict) -> dict:
    return {
        name: {"dtype": str(np.asarray(values).dtype), "shape": list(values.shape[1:]) or [1], "names": None}
        for name, values in columns.items()
        if isinstance(values, np.ndarray)
    }


def picture(values: np.ndarray, kind: str = "PNG") -> dict:
    """The cell of a frame's picture."""
    from PIL import Image

    file = BytesIO()
    Image.fromarray(values).save(file, kind)
    return {"bytes": file.getvalue(), "path": None}


def write_dataset(folder: Path, columns: dict, features: dict | None = None, **info: object) -> Path:
    """A dataset of `columns` (arrays, or lists of cells), told of by `features`, in a new folder."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    for name in ("data/chunk-000", "meta/episodes/chunk-000"):
        (folder / name).mkdir(parents=True)
    cells = {name: each.tolist() if isinstance(each, np.ndarray) else each for name, each in columns.items()}
    pq.write_table(pa.table(cells), folder / "data" / "chunk-000" / "file-000.parquet")
    episodes = {"episode_index": range(len(LENGTHS)), "length": LENGTHS}
    table = pa.table({name: list(values) for name, values in episodes.items()})
    pq.write_table(table, folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    tasks = pa.table({"task_index": [0, 1], "__index_level_0__": ["lift the mug", "lift the bowl"]})
    pq.write_table(tasks, folder / "meta" / "tasks.parquet")
    told = {
        "codebase_version": "v3.0",
        "fps": 10,
        "total_episodes": len(LENGTHS),
        "total_frames": sum(LENGTHS),
        "features": {**describe(columns), **(features or {})},
        **info,
    }
    (folder / "meta" / "info.json").write_text(json.dumps(told))
    return folder
