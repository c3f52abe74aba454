"""Demonstrations on disk: shards of whole episodes, memory-mapped, with a card that tells what they are.

    <path>/card.json                   what all shards hold together
    <path>/shard_00000/shard.json      its episodes: object, seed, rows, success; its files and their bytes
    <path>/shard_00000/rows/...        rows of CompactTransitions, a folder of TensorDict.memmap

A shard appears under its name once it is complete, so that a collection that was killed goes on
after the last one: nothing is lost or doubled if shard k is always collected from the same seed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

import torchgrasp
from torchgrasp import keys
from torchgrasp.data.compact import CompactTransitions
from torchgrasp.data.files import replace_folder, write_json_atomically
from torchgrasp.data.sampler import SOURCE, STUB
from torchgrasp.errors import CheckpointError, ConfigError

_FORMAT = 1
_CARD, _SHARD, _ROWS = "card.json", "shard.json", "rows"


@dataclass(frozen=True)
class EpisodeRecord:
    """One demonstration: what was grasped, the seed it was collected from, its rows and its outcome.

    `rows` is the number of its steps, and one more if the episode was truncated: its last observation.
    """

    object: str
    seed: int
    rows: int
    success: bool


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
        """Rows (R) shard by shard, for `MixtureReplayBuffer.extend_rows`."""
        yield from self.shards

    def iterate_episodes(self, codec: CompactTransitions | None = None) -> Iterator[TensorDictBase]:
        """Episodes (T), decoded, with ("next", ...), in the order in which they were appended."""
        codec = codec or CompactTransitions()
        for rows, records in zip(self.shards, self.records, strict=True):
            start = 0
            for record in records:
                yield decode_episode(rows[start : start + record.rows], codec)
                start += record.rows


def decode_episode(rows: TensorDictBase, codec: CompactTransitions) -> TensorDictBase:
    """Rows (R) of one episode in order of time to its steps (T) with next states."""
    observations = rows.select(*codec.observation_keys)
    last = observations[-1:]
    following = torch.cat([observations[1:], last])  # pyright: ignore[reportArgumentType, reportCallIssue]
    steps = rows.copy().set("next", following)
    return codec.decode(steps[~rows[STUB].squeeze(-1)])


def append_shard(
    path: str | Path,
    episodes: Sequence[TensorDictBase],
    *,
    objects: Sequence[str],
    seeds: Sequence[int],
    index: int,
    codec: CompactTransitions | None = None,
) -> dict[str, Any]:
    """Add complete `episodes` (T_i), one object name and seed each, as shard `index`; returns the card.

    `index` must be the number of shards that are there, so that a shard collected twice, or one
    left out, is refused.
    """
    path = Path(path)
    folders = _find_shards(path)
    if index != len(folders):
        raise ConfigError(
            f"{path} has {len(folders)} shards, shard {index} was given: append {len(folders)}."
        )
    if not episodes or not len(episodes) == len(objects) == len(seeds):
        raise ConfigError(
            f"{len(episodes)} episodes, {len(objects)} objects and {len(seeds)} seeds: give as many of each."
        )
    codec = codec or CompactTransitions()
    encoded = [codec.encode(_check_episode(number, episode)) for number, episode in enumerate(episodes)]
    records = [
        {
            "object": name,
            "seed": int(seed),
            "rows": len(rows),
            "success": bool(rows[keys.EPISODE_SUCCESS][-1]),
        }
        for rows, name, seed in zip(encoded, objects, seeds, strict=True)
    ]
    rows = torch.cat(encoded).exclude(SOURCE)  # pyright: ignore
    with replace_folder(path / f"shard_{index:05d}") as folder:
        rows.memmap(str(folder / _ROWS))
        files = {str(f.relative_to(folder)): f.stat().st_size for f in folder.rglob("*") if f.is_file()}
        shard = {"format": _FORMAT, "episodes": records, "files": files, "versions": _versions()}
        (folder / _SHARD).write_text(json.dumps(shard))
    return _write_card(path)


def _check_episode(number: int, episode: TensorDictBase) -> TensorDictBase:
    done = episode["next", "done"].reshape(-1)
    if episode.ndim != 1 or not bool(done[-1]) or bool(done[:-1].any()):
        raise ConfigError(
            f"Episode {number} of shape {tuple(episode.shape)} is no whole episode (T) that ends at its last "
            "step: cut rollouts up with split_episodes."
        )
    return episode


def open_demonstrations(path: str | Path) -> Demonstrations:
    """Open the complete shards below `path`; CheckpointError names a file that is missing or cut short."""
    path = Path(path)
    folders = _find_shards(path)
    if not folders:
        raise CheckpointError(f"There are no demonstrations at {path}: collect some, or name their folder.")
    metadata = [_read_shard(folder) for folder in folders]
    return Demonstrations(
        path,
        tuple(_load_rows(folder) for folder in folders),
        tuple(tuple(EpisodeRecord(**record) for record in shard["episodes"]) for shard in metadata),
        _summarise(metadata),
    )


def count_shards(path: str | Path) -> int:
    """Complete shards below `path`, 0 if there is nothing: the number of the next one to collect."""
    return len(_find_shards(Path(path)))


def _find_shards(path: Path) -> list[Path]:
    folders = sorted(path.glob("shard_[0-9]*"))
    for number, folder in enumerate(folders):
        if folder.name != f"shard_{number:05d}":
            raise CheckpointError(f"{path} lacks shard_{number:05d}: restore it, or delete the later shards.")
    return folders


def _read_shard(folder: Path) -> dict[str, Any]:
    remedy = f"restore it from a copy, or delete {folder} and the shards after it and collect them again"
    try:
        shard = json.loads((folder / _SHARD).read_text())
        files, _, version = dict(shard["files"]), list(shard["episodes"]), shard["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{folder / _SHARD} is missing or damaged ({error}): {remedy}.") from error
    if version != _FORMAT:
        raise CheckpointError(
            f"{folder} has format {version}, this version reads {_FORMAT}: update torchgrasp."
        )
    for name, size in files.items():
        file = folder / name
        found = file.stat().st_size if file.is_file() else None
        if found != size:
            state = "is missing" if found is None else f"has {found} bytes instead of {size}"
            raise CheckpointError(f"{file} {state}: {remedy}.")
    return shard


def _load_rows(folder: Path) -> TensorDictBase:
    try:
        return TensorDict.load_memmap(folder / _ROWS, allow_pickle=False)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError) as error:
        raise CheckpointError(
            f"{folder / _ROWS} cannot be read ({error}): restore it from a copy."
        ) from error


def _summarise(shards: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    objects: dict[str, dict[str, int]] = {}
    records = [record for shard in shards for record in shard["episodes"]]
    for record in records:
        counts = objects.setdefault(record["object"], {"episodes": 0, "successes": 0})
        counts["episodes"] += 1
        counts["successes"] += int(record["success"])
    successes = sum(counts["successes"] for counts in objects.values())
    return {
        "format": _FORMAT,
        "shards": len(shards),
        "episodes": len(records),
        "successes": successes,
        "success_rate": successes / max(len(records), 1),
        "rows": sum(record["rows"] for record in records),
        "successful_steps": sum(record["rows"] for record in records if record["success"]),
        "bytes": sum(sum(shard["files"].values()) for shard in shards),
        "objects": dict(sorted(objects.items())),
        "seeds": sorted({record["seed"] for record in records}),
        "versions": shards[-1]["versions"],
    }


def _write_card(path: Path) -> dict[str, Any]:
    card = _summarise([_read_shard(folder) for folder in _find_shards(path)])
    write_json_atomically(path / _CARD, card)
    return card


def _versions() -> dict[str, str]:
    return {"torchgrasp": torchgrasp.__version__, "torch": torch.__version__}
