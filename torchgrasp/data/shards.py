"""Shards: folders of whole episodes, written whole or not at all, checked when they are read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import Field, model_validator
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.data.compact import CompactTransitions
from torchgrasp.data.demonstration_card import (
    COUNTS,
    FORMAT,
    Sums,
    add_to_card,
    begin_demonstrations,
    check_format,
    read_card,
    write_card,
)
from torchgrasp.data.files import (
    FileRecord,
    check_file,
    describe_file,
    prove_room,
    read_sealed_json,
    replace_folder,
    seal_json,
)
from torchgrasp.data.mapped_rows import check_columns, map_rows
from torchgrasp.data.sampler import STUB
from torchgrasp.documents import Amount, Count, Document, InnerPath, Name, Whole, check_document, reading
from torchgrasp.errors import CheckpointError, ConfigError, DamageError, printable
from torchgrasp.versions import versions

_SHARD, _ROWS = "shard.json", "rows"


class EpisodeRecord(Document):
    """One episode: what was grasped, the seed it was collected from, its rows and its outcome.

    `rows` is the number of its steps, and one more if the episode was truncated: its last observation.
    """

    object: Name
    seed: Whole
    rows: Annotated[Count, Field(ge=1)]
    success: bool


class Shard(Document):
    """shard.json: the episodes in the order of their rows, and the files beside it."""

    format: Literal[2]
    episodes: list[EpisodeRecord]
    sums: Sums
    wall_seconds: Amount
    files: dict[InnerPath, FileRecord]
    versions: dict[Name, Name]

    @model_validator(mode="after")
    def _check_sums(self) -> Shard:
        if sum(record.rows for record in self.episodes) != self.sums.rows:
            raise ValueError("the sum of the episodes' rows")
        if self.sums.attempts < len(self.episodes):
            raise ValueError("at least as many attempts as episodes")
        return self


def append_shard(
    path: str | Path,
    episodes: Sequence[TensorDictBase],
    *,
    objects: Sequence[str],
    seeds: Sequence[int],
    index: int,
    attempts: int | None = None,
    wall_seconds: float = 0.0,
    codec: CompactTransitions | None = None,
) -> dict[str, Any]:
    """Add complete `episodes` (T_i), one object name and seed each, as shard `index`; returns the card.

    `index` must be the number of shards that are there, so that a shard collected twice, or one
    left out, is refused. A shard may be empty: none of its `attempts` was of the kind wanted.

    Args:
        path: a folder of `begin_demonstrations`; one that is not there yet gets the kind perturbed.
        episodes: each of them whole, ("next", "done") true at its last step alone.
        objects: names.
        seeds: from which they were collected.
        index: of the shard.
        attempts: episodes that were run for it, those that were not kept included.
        wall_seconds: that they took.
        codec: how transitions are stored; CompactTransitions() if None.
    """
    codec = codec or CompactTransitions()
    encoded = [codec.encode(_check_episode(number, episode)) for number, episode in enumerate(episodes)]
    return append_rows(
        path,
        encoded,
        objects=objects,
        seeds=seeds,
        index=index,
        attempts=len(episodes) if attempts is None else attempts,
        wall_seconds=wall_seconds,
    )


def append_rows(
    path: str | Path,
    episodes: Sequence[TensorDictBase],
    *,
    objects: Sequence[str],
    seeds: Sequence[int],
    index: int,
    attempts: int,
    wall_seconds: float = 0.0,
) -> dict[str, Any]:
    """`append_shard` of episodes that are rows (R_i) already, as the codec's `encode` gives them."""
    if not len(episodes) == len(objects) == len(seeds):
        raise ConfigError(
            f"{len(episodes)} episodes, {len(objects)} objects and {len(seeds)} seeds: give as many of each."
        )
    path = Path(path)
    folders = find_shards(path)
    if index != len(folders):
        raise ConfigError(
            f"{path} has {len(folders)} shards, shard {index} was given: append {len(folders)}."
        )
    card = _current_card(path, folders)
    records = [
        {
            "object": printable(name),
            "seed": int(seed),
            "rows": len(rows),
            "success": bool(rows[keys.EPISODE_SUCCESS][-1]),
        }
        for rows, name, seed in zip(episodes, objects, seeds, strict=True)
    ]
    with replace_folder(path / shard_name(index)) as folder:
        sums = {"attempts": attempts, **_write_rows(folder, episodes)}
        files = {str(file.relative_to(folder)): file for file in sorted(folder.rglob("*")) if file.is_file()}
        shard = {
            "format": FORMAT,
            "episodes": records,
            "sums": sums,
            "wall_seconds": round(wall_seconds, 3),
            "files": {name: describe_file(file) for name, file in files.items()},
            "versions": versions(),
        }
        whole = check_document(shard, Shard, path / shard_name(index), "give other objects, seeds or times")
        (folder / _SHARD).write_text(seal_json(whole.model_dump()))
    return write_card(path, add_to_card(card, shard))


def _write_rows(folder: Path, episodes: Sequence[TensorDictBase]) -> dict[str, int]:
    """Write the rows of all episodes into the folder; returns what was counted in them."""
    if not episodes:
        return dict.fromkeys(COUNTS, 0)
    rows = torch.cat(list(episodes)).exclude(keys.SOURCE)  # pyright: ignore
    prove_room(folder, (column.nbytes for column in rows.values(True, True)))
    rows.memmap(str(folder / _ROWS))
    return _count_rows(rows)


def _count_rows(rows: TensorDictBase) -> dict[str, int]:
    """What a shard's sums tell of its rows (R)."""
    step = ~rows[STUB]
    flags = (keys.EPISODE_SUCCESS, keys.PERTURBED, keys.HAS_EXPERT)
    success, perturbed, labelled = (int((rows[key] & step).sum()) for key in flags)
    steps = int(step.sum())
    counts = (len(rows), steps, success, steps - success, perturbed, labelled)
    return dict(zip(COUNTS, counts, strict=True))


def _check_episode(number: int, episode: TensorDictBase) -> TensorDictBase:
    done = episode["next", "done"].reshape(-1)
    if episode.ndim != 1 or not bool(done[-1]) or bool(done[:-1].any()):
        raise ConfigError(
            f"Episode {number} of shape {tuple(episode.shape)} is no whole episode (T) that ends at its last "
            "step: cut rollouts up with split_episodes."
        )
    return episode


def _current_card(path: Path, folders: Sequence[Path]) -> dict[str, Any]:
    """The card of all shards, of which card.json lacks the last where the process was killed just then."""
    begun = bool(folders) or (path.is_dir() and any(path.glob("*.json")))
    card = read_card(path) if begun else begin_demonstrations(path)
    for folder in folders[card["shards"] :]:
        card = add_to_card(card, open_shard(folder, verify=False)[0].model_dump())
    return card


def count_shards(path: str | Path) -> int:
    """Complete shards below `path`, 0 if there is nothing: the number of the next one to collect."""
    return len(find_shards(Path(path)))


def shard_name(number: int) -> str:
    """The folder's name of a shard."""
    return f"shard_{number:05d}"


def _describe_remedy(path: Path) -> str:
    return (
        "restore it from a copy, or delete all from there on by "
        f"`python -m torchgrasp dataset {path} --drop-damaged` and collect again"
    )


def find_shards(path: Path) -> list[Path]:
    """The folders of the shards below `path` in order; CheckpointError names one that is missing."""
    folders = sorted(path.glob("shard_[0-9]*"))
    for number, folder in enumerate(folders):
        if folder.name != shard_name(number):
            raise CheckpointError(f"{path} lacks {shard_name(number)}: {_describe_remedy(path)}.")
    return folders


def open_shard(folder: Path, *, verify: bool) -> tuple[Shard, TensorDictBase]:
    """What shard.json says of the shard in `folder`, and its rows (R), mapped; see `map_rows`.

    With `verify` every byte is read, and what is told of the rows is compared with them; without it, sizes
    are compared. DamageError names a file that is not as it was written.
    """
    remedy = _describe_remedy(folder.parent)
    told = read_sealed_json(folder / _SHARD, remedy)
    check_format(folder, told.get("format"))
    shard = check_document(told, Shard, folder / _SHARD, remedy, error=DamageError)
    for name, expected in shard.files.items():
        check_file(folder / name, expected, remedy, checksum=verify)
    _refuse_others(folder, shard, remedy)
    rows = map_rows(folder / _ROWS, remedy)
    check_columns(rows, folder / _ROWS, remedy)
    if len(rows) != shard.sums.rows or (verify and not _tells_of(shard, rows)):
        raise DamageError(f"{folder / _SHARD} tells of other rows than those in {_ROWS}: {remedy}.")
    return shard, rows


def _refuse_others(folder: Path, shard: Shard, remedy: str) -> None:
    """Refuse files among the rows that shard.json does not guard, but for those that systems hide."""
    with reading(folder, remedy):
        files = [each for each in (folder / _ROWS).rglob("*") if each.is_file() and each.name[0] != "."]
    for file in files:
        if str(file.relative_to(folder)) not in shard.files:
            raise DamageError(f"{file} is no file of the shard that it lies in: {remedy}.")


def _tells_of(shard: Shard, rows: TensorDictBase) -> bool:
    if not shard.episodes:
        return True
    lasts = torch.tensor([record.rows for record in shard.episodes]).cumsum(0) - 1
    success: Any = rows[keys.EPISODE_SUCCESS]
    counts = {name: getattr(shard.sums, name) for name in COUNTS}
    told = [record.success for record in shard.episodes]
    return success[lasts].flatten().tolist() == told and counts == _count_rows(rows)
