"""Demonstrations on disk: shards of whole episodes, memory-mapped, with a card that tells what they are.

    <path>/card.json                   what all shards hold together, their kind, what made them
    <path>/shard_00000/shard.json      its episodes: object, seed, rows, success; its files with checksums
    <path>/shard_00000/rows/...        rows of CompactTransitions, a folder of TensorDict.memmap

A shard appears under its name once it is complete, so that a collection that was killed goes on
after the last one: nothing is lost or doubled if shard k always holds the same episodes. Every byte
is guarded by a CRC-32.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import TensorDictReplayBuffer
from torchrl.data.replay_buffers.writers import ImmutableDatasetWriter
from torchrl.envs.transforms import Compose, Transform

from torchgrasp.data.compact import CompactTransitions
from torchgrasp.data.demonstration_card import add_to_card, empty_card, read_card, write_card
from torchgrasp.data.folder_lock import own_folder
from torchgrasp.data.sampler import STUB
from torchgrasp.data.shard_storage import ShardStorage
from torchgrasp.data.shards import EpisodeRecord, find_shards, open_shard, shard_name
from torchgrasp.data.storage import keep_batch
from torchgrasp.documents import reading
from torchgrasp.errors import CheckpointError, ConfigError, DamageError


@dataclass(frozen=True)
class Demonstrations:
    """Complete shards of demonstrations below `path`, opened for reading.

    Attributes:
        path: the folder.
        shards: per shard, its rows (R), memory-mapped and encoded as CompactTransitions does.
        records: per shard, its episodes in the order of their rows.
        card: what card.json says.
    """

    path: Path
    shards: tuple[TensorDictBase, ...]
    records: tuple[tuple[EpisodeRecord, ...], ...]
    card: dict[str, Any]

    @property
    def num_shards(self) -> int:
        """Complete shards; also the number of the next one to append."""
        return len(self.shards)

    @property
    def num_episodes(self) -> int:
        """Episodes of all shards."""
        return sum(map(len, self.records))

    def iterate_rows(self) -> Iterator[TensorDictBase]:
        """Rows (R) shard by shard, for `MixtureReplayBuffer.extend_rows`; empty shards are left out."""
        yield from (rows for rows in self.shards if len(rows))

    def iterate_episode_rows(self) -> Iterator[tuple[EpisodeRecord, TensorDictBase]]:
        """Each episode's record and rows (R_i), encoded, in the order in which they were appended."""
        for rows, records in zip(self.shards, self.records, strict=True):
            start = 0
            for record in records:
                yield record, rows[start : start + record.rows]
                start += record.rows

    def iterate_episodes(self, codec: CompactTransitions | None = None) -> Iterator[TensorDictBase]:
        """Episodes (T), decoded, with ("next", ...), in the order in which they were appended."""
        codec = self._choose(codec)
        for _, rows in self.iterate_episode_rows():
            yield decode_episode(rows, codec)

    def buffer(
        self,
        *,
        batch_size: int,
        count: str = "all",
        codec: CompactTransitions | None = None,
        transform: Transform | None = None,
        seed: int = 0,
        prefetch: int | None = None,
    ) -> TensorDictReplayBuffer:
        """A read-only TorchRL buffer that draws transitions (B) from the files, which it does not copy.

        Args:
            batch_size: rows of a batch.
            count: which episodes are drawn from: all, successful or failed.
            codec: what the rows were encoded with; CompactTransitions() if None.
            transform: applied to sampled transitions, after decoding.
            seed: of the draws.
            prefetch: batches that a background thread draws ahead.
        """
        codec = self._choose(codec)
        storage = ShardStorage(tuple(self.iterate_rows()), next_keys=codec.observation_keys, count=count)
        return TensorDictReplayBuffer(
            storage=storage,
            collate_fn=keep_batch,
            writer=ImmutableDatasetWriter(),
            transform=codec if transform is None else Compose(codec, transform),  # pyright: ignore
            batch_size=batch_size,
            prefetch=prefetch,
            generator=torch.Generator().manual_seed(seed),
        )

    def _choose(self, codec: CompactTransitions | None) -> CompactTransitions:
        """`codec` or the usual one, once the rows have what it decodes."""
        codec = codec or CompactTransitions()
        for rows in self.iterate_rows():
            lacking = [key for key in codec.observation_keys if rows.get(key, None) is None]
            if lacking:
                raise ConfigError(f"{self.path} has no {lacking}: give the codec= that it was written with.")
        return codec


def decode_episode(rows: TensorDictBase, codec: CompactTransitions) -> TensorDictBase:
    """Rows (R) of one episode in order of time to its steps (T) with next states."""
    observations = rows.select(*codec.observation_keys)
    last = observations[-1:]
    following = torch.cat([observations[1:], last])  # pyright: ignore[reportArgumentType, reportCallIssue]
    steps = rows.copy().set("next", following)
    return codec.decode(steps[~rows[STUB].squeeze(-1)])


def open_demonstrations(path: str | Path, *, verify: bool = True) -> Demonstrations:
    """Open the complete shards below `path`; CheckpointError names a file that is missing or was changed.

    Args:
        path: the folder.
        verify: reads every byte and compares checksums (1 GB takes about a second); without it, sizes
            alone are compared.
    """
    path = Path(path)
    _list_folder(path)
    folders = find_shards(path)
    told = read_card(path)
    opened = [open_shard(folder, verify=verify) for folder in folders]
    metadata = [shard.model_dump() for shard, _ in opened]
    _check_card(path, told, metadata)
    if not folders:
        raise CheckpointError(f"{path} holds no shard of demonstrations yet: go on collecting.")
    return Demonstrations(
        path,
        tuple(rows for _, rows in opened),
        tuple(tuple(shard.episodes) for shard, _ in opened),
        _summarise(told, metadata),
    )


def drop_damaged_shards(path: str | Path) -> list[str]:
    """Delete the first damaged shard below `path` and those after it; returns their names.

    Collecting goes on from there, and makes the same shards again. A shard is damaged if one of its
    files is missing, or differs in size or checksum; one that cannot be read now, or is of another
    format, raises CheckpointError and stays. An import, which nobody can collect again, is refused.
    """
    path = Path(path)
    folders = [each for each in _list_folder(path) if each.match("shard_[0-9]*")]
    with own_folder(path):
        return _drop_damaged(path, folders)


def _drop_damaged(path: Path, folders: list[Path]) -> list[str]:
    told = read_card(path)
    if "imported_from" in told["provenance"]:
        raise ConfigError(
            f"{path} was imported from {told['provenance']['imported_from']} and cannot be collected again: "
            "delete it and import it anew, or restore it from a copy."
        )
    whole = []
    for number, folder in enumerate(folders):
        if folder.name != shard_name(number):
            break
        try:
            whole.append(open_shard(folder, verify=True)[0].model_dump())
        except DamageError:
            break
    dropped = folders[len(whole) :]
    for folder in reversed(dropped):
        shutil.rmtree(folder)
    write_card(path, _summarise(told, whole))
    return [folder.name for folder in dropped]


def _list_folder(path: Path) -> list[Path]:
    """What is in the folder, in order; unlike `glob`, never nothing because it cannot be read."""
    with reading(path, "name a folder"):
        found = sorted(path.iterdir()) if path.is_dir() else []
    if not found:
        raise CheckpointError(f"There are no demonstrations at {path}: collect some, or name their folder.")
    return found


def _summarise(card: dict[str, Any], shards: Sequence[dict[str, Any]]) -> dict[str, Any]:
    summary = empty_card(card["kind"], card["provenance"])
    for shard in shards:
        summary = add_to_card(summary, shard)
    return summary


def _check_card(path: Path, told: dict[str, Any], shards: Sequence[dict[str, Any]]) -> None:
    """Refuse a card that tells of other shards; the last may be missing in it, if the process was killed."""
    number = told["shards"]
    if number > len(shards):
        raise CheckpointError(
            f"{path} lacks {shard_name(len(shards))}, card.json tells of {number}: restore it from a copy."
        )
    if number < len(shards) - 1 or told != _summarise(told, shards[:number]):
        raise CheckpointError(
            f"{path / 'card.json'} tells of other shards than those beside it: restore both from one copy."
        )
