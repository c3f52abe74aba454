"""Demonstrations as Minari datasets (Farama's format, HDF5), and Minari datasets as demonstrations.

    observations  (T + 1, ...)  points as on disk (float16, without the gripper's), time_left, other states
    actions       (T, 6)        relative hand poses
    rewards, terminations, truncations (T)
    infos         (T + 1, ...)  expert_action, has_expert, goal, has_goal, perturbed, episode_success, ...
    seed, options/object        of each episode

`infos[t]` belongs to `observations[t]`, as in Minari's own recordings. An episode that terminated has
no observation after its end: the last one stands there twice, with infos of zeros.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from torchgrasp import keys
from torchgrasp.data.compact import CompactTransitions
from torchgrasp.data.demonstration_card import Card
from torchgrasp.data.demonstrations import Demonstrations
from torchgrasp.data.files import replace_folder
from torchgrasp.data.foreign_columns import check_alike
from torchgrasp.data.imported_episodes import check_unused, in_groups, name_object, write_imported
from torchgrasp.data.minari.dataset_files import CARD, REMEDY, check_hdf5, read_metadata
from torchgrasp.data.minari.episode_columns import columns_to_rows, make_space, rows_to_columns
from torchgrasp.documents import shorten
from torchgrasp.errors import CheckpointError, ConfigError


def load_minari() -> Any:
    """The module minari, with what it needs for HDF5; ConfigError names the extra where that is missing."""
    try:
        import h5py  # noqa: F401
        import minari
        from PIL import Image  # noqa: F401
    except ImportError as error:
        raise ConfigError(f'Minari is not installed ({error}): pip install "torchgrasp[minari]".') from error
    return minari


def find_dataset(name: str | Path) -> tuple[Path, str]:
    """The folder and the id of the Minari dataset `name`, whether or not it is there.

    Args:
        name: an id such as ``torchgrasp/expert-v0``, found where Minari keeps its datasets; or a
            folder, as a Path or a string that begins with ``/``, ``.`` or ``~``.
    """
    minari = load_minari()
    parse = minari.dataset.minari_dataset.parse_dataset_id
    if isinstance(name, Path) or name[:1] in ("/", ".", "~"):
        folder = Path(name).expanduser().absolute()
        identity = folder.name if re.search(r"-v\d+$", folder.name) else f"{folder.name}-v0"
    else:
        folder, identity = minari.storage.get_dataset_path(name), name
    try:
        parse(identity)
    except (ValueError, TypeError) as error:
        raise ConfigError(
            f"{identity!r} is no id of a Minari dataset: give <namespace>/<name>-v<number> of letters, "
            "digits, _ and -, or a folder whose name is like that."
        ) from error
    return folder, identity


def export_minari(
    demonstrations: Demonstrations, target: str | Path, *, codec: CompactTransitions | None = None
) -> Path:
    """Write `demonstrations` as a new Minari dataset, whole or not at all; returns its folder.

    Args:
        demonstrations: what to write; one shard at a time is in memory.
        target: see `find_dataset`; a dataset that is there already is refused.
        codec: what the rows were encoded with; CompactTransitions() if None.
    """
    minari = load_minari()
    codec = codec or CompactTransitions()
    folder, identity = find_dataset(target)
    if folder.exists():
        raise ConfigError(f"{folder} is there already: give another name, or delete it first.")
    sample = next(iter(demonstrations.iterate_rows()), None)
    if sample is None:
        raise ConfigError(f"{demonstrations.path} holds no episode: there is nothing to export.")
    with replace_folder(folder) as new:
        storage = minari.dataset.minari_storage.MinariStorage.new(
            new / "data",
            observation_space=make_space(sample, codec.observation_keys),
            action_space=make_space(sample, [keys.ACTION])[keys.ACTION],
            data_format="hdf5",
            jpeg_encoding=False,  # pictures come back as they were
        )
        for some in in_groups(demonstrations.iterate_episode_rows(), lambda episode: episode[1]):
            storage.update_episodes(
                [
                    minari.data_collector.EpisodeBuffer(
                        seed=record.seed, options={"object": record.object}, **rows_to_columns(rows, codec)
                    )
                    for record, rows in some
                ]
            )
        storage.update_metadata(_describe(demonstrations, identity, minari.__version__))
    return folder


def _describe(demonstrations: Demonstrations, identity: str, version: str) -> dict[str, Any]:
    card = demonstrations.card
    words = {"expert": "expert", "perturbed": "perturbed expert", "failed": "expert made to fail"}
    return {
        "dataset_id": identity,
        "minari_version": version,
        "algorithm_name": words.get(card["kind"], card["kind"]),
        "description": f"6-DoF grasping from point clouds by torchgrasp: {card['episodes']} episodes, "
        f"{card['successes']} successful. Points are in the hand's frame, metres.",
        CARD: card,
    }


def import_minari(
    source: str | Path, path: str | Path, *, kind: str | None = None, codec: CompactTransitions | None = None
) -> dict[str, Any]:
    """Write the Minari dataset `source` as demonstrations into the new folder `path`; returns their card.

    The folder is there once all is imported. An export of `export_minari` comes back row for row.
    Other datasets need observations named as the codec's and actions (6); labels that they lack are
    stored as absent. ConfigError names the episode and column that cannot be used.

    Args:
        source: see `find_dataset`.
        path: holds no demonstrations yet.
        kind: of the demonstrations, in place of what the dataset says; by default that, or expert
            where it says nothing.
        codec: how transitions are stored; CompactTransitions() if None.
    """
    codec, path = codec or CompactTransitions(), Path(path)
    check_unused(path)
    dataset, told = _open(source)
    episodes = _read_episodes(dataset, codec, ours=told is not None)
    return write_imported(path, episodes, source=dataset.id, told=told, kind=kind)


def _open(source: str | Path) -> tuple[Any, Card | None]:
    """The MinariDataset, once its files are harmless, and the card where an export wrote one."""
    minari = load_minari()
    folder, identity = find_dataset(source)
    data = folder / "data" if (folder / "data").is_dir() else folder
    if not data.is_dir():
        raise CheckpointError(
            f"There is no Minari dataset at {folder}: name its folder, or get it by "
            f"`minari download {identity}`."
        )
    metadata = read_metadata(data)
    if not metadata.total_episodes:
        raise ConfigError(f"{data} holds no episode: there is nothing to import.")
    check_hdf5(data, metadata.total_episodes)
    try:
        return minari.MinariDataset(data), metadata.torchgrasp
    except Exception as error:  # whatever Minari and Gymnasium raise, the remedy is the same
        raise CheckpointError(f"{data} is damaged or no Minari dataset ({error}): {REMEDY}.") from error


def _read_episodes(
    dataset: Any, codec: CompactTransitions, *, ours: bool
) -> Iterator[tuple[TensorDict, str, int]]:
    """Rows, the object's name and the seed of each episode."""
    first = None
    for number in dataset.episode_indices:
        episode, told = _read_episode(dataset, number)
        options, seed = told.get("options", {}), told.get("seed") or 0
        if not isinstance(options, dict) or not -(2**63) <= seed < 2**63:
            raise ConfigError(
                f"Episode {number} has options {shorten(options)} and the seed {seed}: mend the dataset."
            )
        rows = columns_to_rows(episode, codec, ours=ours)
        first = check_alike(number, rows, first)
        yield rows, name_object(options.get("object", "unknown")), seed


def _read_episode(dataset: Any, number: int) -> tuple[Any, dict[str, Any]]:
    """What Minari gives of an episode, and the attributes beside it."""
    try:
        (episode,) = dataset.iterate_episodes([number])
        (told,) = dataset.storage.get_episode_metadata([number])
        return episode, told
    except Exception as error:  # HDF5 and Minari raise what their libraries do
        raise CheckpointError(
            f"{dataset.storage.data_path} cannot be read ({type(error).__name__}: {error}): {REMEDY}."
        ) from error
