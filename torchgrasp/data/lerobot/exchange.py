"""Demonstrations as LeRobotDatasets (version 3.0), and LeRobotDatasets as demonstrations.

    observation.images.depth, .mask, .rgb           pictures of the wrist camera, TIFF of floats and PNG
    observation.state                               joints (9)
    observation.T_base_ee, observation.T_base_camera (4, 4)
    observation.points, observation.time_left, ...  what else networks read
    action (6), next.reward, next.terminated, next.done
    expert_action, has_expert, goal, has_goal, perturbed, episode_success, ...
    task                                            the object's name

A frame is a step: what was observed, and what was done then. The files lie as `dataset_files` tells.
Written and read after LeRobot's format, by pyarrow alone: LeRobot itself is not needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from torchgrasp.data.compact import CompactTransitions
from torchgrasp.data.demonstrations import Demonstrations
from torchgrasp.data.files import replace_folder
from torchgrasp.data.foreign_columns import check_alike
from torchgrasp.data.imported_episodes import ImportedEpisode, check_unused, name_object, write_imported
from torchgrasp.data.lerobot.dataset_files import (
    LAST,
    REMEDY,
    DatasetFiles,
    check_counters,
    read_dataset,
)
from torchgrasp.data.lerobot.dataset_writer import DatasetWriter
from torchgrasp.data.lerobot.episode_frames import Frames, check_frames, frames_to_rows, read_frames
from torchgrasp.data.lerobot.features import Feature, check_sizes, find_features, recall_feature
from torchgrasp.data.lerobot.others_features import choose_features, others_to_rows
from torchgrasp.errors import CheckpointError, ConfigError


def load_pyarrow() -> Any:
    """The module pyarrow, with Pillow beside it; ConfigError names the extra where one is missing."""
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
        from PIL import Image  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f'LeRobotDatasets need pyarrow and Pillow ({error}): pip install "torchgrasp[lerobot]".'
        ) from error
    return pyarrow


def export_lerobot(demonstrations: Demonstrations, target: str | Path) -> Path:
    """Write `demonstrations` as a new LeRobotDataset, whole or not at all; returns its folder.

    Every column is written, whatever codec the rows were encoded with: clouds and pictures in the types
    in which demonstrations keep them.

    Args:
        demonstrations: what to write; one episode at a time is in memory.
        target: a folder that is not there yet.
    """
    load_pyarrow()
    folder = Path(target).expanduser().absolute()
    if folder.exists():
        raise ConfigError(f"{folder} is there already: give another name, or delete it first.")
    sample = next(iter(demonstrations.iterate_rows()), None)
    if sample is None:
        raise ConfigError(f"{demonstrations.path} holds no episode: there is nothing to export.")
    first = None
    with replace_folder(folder) as new, DatasetWriter(new, find_features(sample)) as writer:
        for number, (record, rows) in enumerate(demonstrations.iterate_episode_rows()):
            first = check_alike(number, rows, first)
            writer.add(rows, task=record.object, seed=record.seed)
        writer.finish(demonstrations.card)
    return folder


def import_lerobot(
    source: str | Path, path: str | Path, *, kind: str | None = None, codec: CompactTransitions | None = None
) -> dict[str, Any]:
    """Write the LeRobotDataset `source` as demonstrations into the new folder `path`; returns their card.

    The folder is there once all is imported. An export of `export_lerobot` comes back row for row.
    Other datasets need an `action` (6), `next.reward` or `next.success`, and features named as NAMES of
    `features` tells for each of the codec's observations; `time_left` is counted where it is missing, and
    labels are stored as absent. ConfigError names the episode and feature that cannot be used.

    Args:
        source: the folder that holds meta/info.json.
        path: holds no demonstrations yet.
        kind: of the demonstrations, in place of what the dataset says; by default that, or expert
            where it says nothing.
        codec: how transitions are stored; CompactTransitions() if None.
    """
    load_pyarrow()
    path = Path(path)
    check_unused(path)
    dataset = read_dataset(Path(source).expanduser().absolute())
    check_counters(dataset.info)
    if dataset.export is None:
        episodes = _read_others(dataset, codec or CompactTransitions())
    else:
        episodes = _read_export(dataset, dataset.export.columns)
    told = None if dataset.export is None else dataset.export.card
    return write_imported(path, episodes, source=dataset.folder.name, told=told, kind=kind)


def _read_export(dataset: DatasetFiles, columns: dict[str, Any]) -> Iterator[ImportedEpisode]:
    """The rows of an export, with what was observed last where an episode was truncated."""
    features = [recall_feature(name, column) for name, column in columns.items()]
    check_sizes(features, "meta/torchgrasp.json", REMEDY)
    file = dataset.folder / LAST
    lasts = read_frames([file] if file.exists() else [], features)
    last, first = next(lasts, None), None
    for frames, name, seed in _read_checked(dataset, features):
        own = last if last is not None and last.number == frames.number else None
        if own is not None:
            check_frames(own, frames.number, 1, first=len(frames))
            last = next(lasts, None)
        rows = frames_to_rows(frames, own, features)
        first = check_alike(frames.number, rows, first)
        yield rows, name, seed
    if last is not None:
        raise CheckpointError(f"{file} tells of episode {last.number}, which is not there: {REMEDY}.")


def _read_others(dataset: DatasetFiles, codec: CompactTransitions) -> Iterator[ImportedEpisode]:
    """Rows of a dataset that others wrote."""
    taken, first = choose_features(dataset.info, codec), None
    for frames, name, seed in _read_checked(dataset, taken.features):
        rows: TensorDict = others_to_rows(frames, taken, codec)
        first = check_alike(frames.number, rows, first)
        yield rows, name, seed


def _read_checked(dataset: DatasetFiles, features: Sequence[Feature]) -> Iterator[tuple[Frames, str, int]]:
    """Each episode's frames, its task's text and its seed, all of them and in order."""
    count = 0
    for count, frames in enumerate(read_frames(dataset.data, features), 1):
        if count > len(dataset.lengths):
            raise CheckpointError(f"The data hold more episodes than meta/episodes tells of: {REMEDY}.")
        check_frames(frames, count - 1, dataset.lengths[count - 1])
        if frames.task not in dataset.tasks:
            raise CheckpointError(
                f"Episode {frames.number} has task {frames.task}, which is not told: {REMEDY}."
            )
        yield frames, name_object(dataset.tasks[frames.task]), dataset.seeds[count - 1]
    if count != len(dataset.lengths):
        raise CheckpointError(
            f"The data hold {count} episodes, meta/episodes tells of {len(dataset.lengths)}: {REMEDY}."
        )
