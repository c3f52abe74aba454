"""The card of a folder of demonstrations: what all of its shards hold together, and where they come from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator

from torchgrasp.data.demonstration_kinds import check_kind
from torchgrasp.data.files import read_sealed_json, seal_json, write_text_atomically, writing
from torchgrasp.documents import (
    Amount,
    Count,
    Document,
    Name,
    Plain,
    Rate,
    Whole,
    check_document,
    reading,
    shorten,
)
from torchgrasp.errors import CheckpointError, ConfigError, DamageError

FORMAT = 2
_CARD = "card.json"
_REMEDY = "restore it from a copy, or collect into another folder"


class ObjectCounts(Document):
    """Of one object."""

    episodes: Count
    successes: Count


class Outline(Document):
    """What a card begins with."""

    format: Literal[2]
    kind: Annotated[str, AfterValidator(check_kind)]
    shards: Count
    episodes: Count
    successes: Count
    success_rate: Rate


class Sums(Document):
    """What is added up over shards: attempts, and what is counted in rows."""

    attempts: Count
    rows: Count
    steps: Count
    successful_steps: Count
    failed_steps: Count
    perturbed_steps: Count
    labelled_steps: Count


class Card(Sums, Outline):
    """card.json: its outline, sums, and then these."""

    bytes: Count
    bytes_per_step: Amount
    wall_seconds: Amount
    objects: dict[Name, ObjectCounts]
    seeds: list[Whole]
    versions: dict[Name, list[Name]]
    provenance: Plain


_SUMS = tuple(Sums.model_fields)
# What is counted in rows.
COUNTS = _SUMS[1:]


def begin_demonstrations(
    path: str | Path, *, kind: str = "perturbed", provenance: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Make the folder `path` for demonstrations of one kind, or take up the one that is there.

    Args:
        path: the folder; one that holds another kind is refused.
        kind: expert, perturbed, failed or learner.
        provenance: JSON-able; what made them, kept in the card. It is not compared with the one there.

    Returns:
        The card.
    """
    path = Path(path)
    with reading(path, _REMEDY):
        there = path.exists()
    if there and not path.is_dir():
        raise ConfigError(f"{path} is a file: give a folder for demonstrations.")
    if any(path.glob("*.json")) or any(path.glob("shard_[0-9]*")):
        card = read_card(path)
        if card["kind"] != check_kind(kind):
            raise ConfigError(
                f"{path} holds demonstrations of the kind {card['kind']}, not {kind}: give another folder, "
                f"or kind={card['kind']}."
            )
        return card
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
    return write_card(path, empty_card(check_kind(kind), provenance or {}))


def empty_card(kind: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """A card of no shards."""
    sums = dict.fromkeys(_SUMS, 0)
    counts = {"shards": 0, "episodes": 0, "successes": 0, "success_rate": 0.0, **sums}
    sizes = {"bytes": 0, "bytes_per_step": 0.0, "wall_seconds": 0.0}
    contents = {"objects": {}, "seeds": [], "versions": {}}
    return {"format": FORMAT, "kind": kind, **counts, **sizes, **contents, "provenance": dict(provenance)}


def add_to_card(card: Mapping[str, Any], shard: Mapping[str, Any]) -> dict[str, Any]:
    """The card with what one shard's shard.json tells added."""
    records = shard["episodes"]
    objects = {name: dict(counts) for name, counts in card["objects"].items()}
    for record in records:
        counts = objects.setdefault(record["object"], {"episodes": 0, "successes": 0})
        counts["episodes"] += 1
        counts["successes"] += int(record["success"])
    sums = {name: card[name] + shard["sums"][name] for name in _SUMS}
    episodes = card["episodes"] + len(records)
    successes = card["successes"] + sum(record["success"] for record in records)
    size = card["bytes"] + sum(file["bytes"] for file in shard["files"].values())
    versions = {name: set(card["versions"].get(name, ())) | {v} for name, v in shard["versions"].items()}
    return {
        **card,
        **sums,
        "shards": card["shards"] + 1,
        "episodes": episodes,
        "successes": successes,
        "success_rate": successes / max(episodes, 1),
        "bytes": size,
        "bytes_per_step": round(size / max(sums["steps"], 1), 1),
        "wall_seconds": round(card["wall_seconds"] + shard["wall_seconds"], 3),
        "objects": dict(sorted(objects.items())),
        "seeds": sorted({*card["seeds"], *(record["seed"] for record in records)}),
        "versions": {name: sorted(each) for name, each in versions.items()},
    }


def read_card(path: Path) -> dict[str, Any]:
    """What card.json in the folder `path` says; CheckpointError where it is missing or damaged."""
    file = path / _CARD
    # Format 1 kept its origin in a file of its own, and no checksums.
    if (path / "origin.json").exists():
        check_format(path, 1)
    card = read_sealed_json(file, _REMEDY)
    check_format(file, card.get("format"))
    return check_document(card, Card, file, _REMEDY, error=DamageError).model_dump()


def check_format(path: Path, number: object) -> None:
    """Raise CheckpointError unless demonstrations of format `number`, as those at `path`, are read here."""
    if number != FORMAT:
        raise CheckpointError(
            f"{path} holds demonstrations of format {shorten(number)}, this torchgrasp reads format "
            f"{FORMAT}: collect them again into another folder, or read them with a torchgrasp of theirs."
        )


def write_card(path: Path, card: Mapping[str, Any]) -> dict[str, Any]:
    """Replace card.json in the folder `path`; returns the card."""
    whole = check_document(card, Card, path / _CARD, "give names and a provenance of plain values")
    write_text_atomically(path / _CARD, seal_json(whole.model_dump()))
    return whole.model_dump()
