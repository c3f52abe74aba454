"""Demonstrations: episodes of one kind, until enough of its steps are stored."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from contextlib import closing
from itertools import count as count_from
from pathlib import Path
from typing import Any

from torchgrasp.data import (
    CompactTransitions,
    append_shard,
    begin_demonstrations,
    count_shards,
    open_demonstrations,
)
from torchgrasp.data.demonstration_kinds import COUNTED, resolve_count
from torchgrasp.data.folder_lock import own_folder
from torchgrasp.errors import ConfigError
from torchgrasp.rollouts.episode_pool import Episode, EpisodePool, Policy
from torchgrasp.runs import Progress

# Rounds of all worlds in a shard, which is written whole or not at all.
SHARD_ROUNDS = 4
# Episodes without one of the kind wanted after which collecting would never end.
_HOPELESS = 200


def collect_demonstrations(
    pool: EpisodePool,
    policy: Policy,
    path: Path,
    *,
    kind: str,
    num_steps: int,
    codec: CompactTransitions,
    seed: int,
    count: str | None = None,
    provenance: Mapping[str, Any] | None = None,
    num_workers: int = 0,
) -> dict:
    """Add shards to the folder `path` until `num_steps` steps are there that count; returns its card.

    Shard k holds the same episodes whenever it is collected, so a collection that was cut off goes on where
    its last whole shard ended. The folder is owned meanwhile: another process that would write there is
    refused.

    Args:
        pool: who runs episodes of its environment `train`.
        policy: acts and labels.
        path: of the demonstrations, made where there is none.
        kind: expert, perturbed, failed or learner; of failed, successes are left out.
        num_steps: wanted.
        codec: how steps are stored.
        seed: of the environment, for the record.
        count: which steps count: all, successful or failed; by default those that the kind is for.
        provenance: what made them, for the card of a new folder.
        num_workers: of the pool; enough shards are run at once for all of them.
    """
    counted = COUNTED[resolve_count(count, kind)]
    card = begin_demonstrations(path, kind=kind, provenance=provenance)
    with own_folder(path):
        if done := count_shards(path):
            card = open_demonstrations(path).card
        initial = min(num_steps, card[counted])
        with (
            closing(_run_shards(pool, policy, done, num_workers)) as shards,
            Progress(num_steps, initial=initial, description=f"{kind} steps", unit="step") as progress,
        ):
            while card[counted] < num_steps:
                before, started = card[counted], time.monotonic()
                index, episodes = next(shards)
                kept = [each for each in episodes if kind != "failed" or not each.success]
                card = append_shard(
                    path,
                    [each.steps for each in kept],
                    objects=[each.object_name for each in kept],
                    seeds=[seed] * len(kept),
                    index=index,
                    attempts=len(episodes),
                    codec=codec,
                    wall_seconds=time.monotonic() - started,
                )
                gained = min(num_steps, card[counted]) - min(num_steps, before)
                progress.update(gained, success_rate=1.0 - _count_failures(card) / card["attempts"])
                _check_hope(card, counted)
    return card


def _count_failures(card: Mapping[str, Any]) -> int:
    """Failed episodes among all that were run; of the kind failed, they alone were kept."""
    return card["episodes"] if card["kind"] == "failed" else card["episodes"] - card["successes"]


def _run_shards(
    pool: EpisodePool, policy: Policy, first: int, num_workers: int
) -> Generator[tuple[int, list[Episode]], None, None]:
    """Each shard's number and episodes from shard `first` on, enough shards at once for all workers."""
    at_once = max(1, -(-num_workers // SHARD_ROUNDS))
    for start in count_from(first, at_once):
        numbers = range(start * SHARD_ROUNDS, (start + at_once) * SHARD_ROUNDS)
        batches = pool.run("train", policy, numbers)
        for index in range(start, start + at_once):
            yield index, [episode for _ in range(SHARD_ROUNDS) for episode in next(batches)]


def _check_hope(card: Mapping[str, Any], counted: str) -> None:
    """Give up where none of many episodes was of use."""
    if card["attempts"] < _HOPELESS or card[counted]:
        return
    if card["kind"] == "failed":
        raise ConfigError(
            f"The expert failed in none of {card['attempts']} episodes: disturb it more often or further."
        )
    raise ConfigError(
        f"No step of {card['attempts']} episodes counts: give more steps to an episode, or objects that the "
        "hand can hold."
    )
