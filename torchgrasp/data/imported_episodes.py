"""Episodes of other formats as demonstrations: a folder that is there once all of them are in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from tensordict import TensorDictBase

from torchgrasp.data.demonstration_card import Card, begin_demonstrations
from torchgrasp.data.files import replace_folder
from torchgrasp.data.shards import append_rows
from torchgrasp.errors import ConfigError, printable

_SHARD_EPISODES = 28
_SHARD_BYTES = 1 << 28
_MAX_NAME = 1000
_T = TypeVar("_T")

# Rows (R), the object's name and the seed.
ImportedEpisode = tuple[TensorDictBase, str, int]


def check_unused(path: Path) -> None:
    """ConfigError unless `path` is a folder that an import may make."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ConfigError(f"{path} is there already: give a folder that does not exist yet.")


def write_imported(
    path: Path, episodes: Iterable[ImportedEpisode], *, source: str, told: Card | None, kind: str | None
) -> dict[str, Any]:
    """Write episodes as demonstrations into the new folder `path`, whole or not at all; returns their card.

    Args:
        path: see `check_unused`.
        episodes: read while they are written, some at a time.
        source: where they come from, for the provenance.
        told: the card that an export brought along.
        kind: of the demonstrations; by default what the card tells, or expert.
    """
    provenance = {**({} if told is None else told.provenance), "imported_from": source}
    if kind is not None:
        provenance["kind"] = kind
    with replace_folder(path) as new:
        begin_demonstrations(new, kind=kind or (told.kind if told else "expert"), provenance=provenance)
        return _append_all(new, episodes, told)


def _append_all(path: Path, episodes: Iterable[ImportedEpisode], told: Card | None) -> dict[str, Any]:
    """Append all episodes, shard by shard; returns the card."""
    # What was run and not kept is told with the first shard, and so is the time that all took.
    dropped, seconds = (max(0, told.attempts - told.episodes), told.wall_seconds) if told else (0, 0.0)
    card: dict[str, Any] = {}
    for index, some in enumerate(in_groups(episodes, lambda episode: episode[0])):
        rows, objects, seeds = zip(*some, strict=True)
        card = append_rows(
            path,
            rows,
            objects=objects,
            seeds=seeds,
            index=index,
            attempts=len(some) + (dropped if index == 0 else 0),
            wall_seconds=seconds if index == 0 else 0.0,
        )
    return card


def in_groups(values: Iterable[_T], get_rows: Callable[[_T], TensorDictBase]) -> Iterator[list[_T]]:
    """Lists of as many episodes as are held in memory, and in a shard; none is read ahead of its list.

    Args:
        values: episodes, read while they are given.
        get_rows: an episode's rows, whose bytes count.
    """
    some: list[_T] = []
    size = 0
    for value in values:
        some.append(value)
        size += sum(column.nbytes for column in get_rows(value).values(True, True))
        if len(some) == _SHARD_EPISODES or size >= _SHARD_BYTES:
            yield some
            some, size = [], 0
    if some:
        yield some


def name_object(told: object) -> str:
    """An object's name as a record holds it, of what another format tells."""
    return printable(told)[:_MAX_NAME]
