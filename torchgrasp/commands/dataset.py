"""``torchgrasp dataset <folder>``: what demonstrations hold, and whether all of it is whole."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from torchgrasp.errors import ConfigError, printable

HELP = "check a folder of demonstrations and print its card; exchange it with Minari or LeRobot"
_FORMATS = ("minari", "lerobot")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    place = "of Minari an id like torchgrasp/expert-v0, or a folder that begins with / or .; else a folder"
    parser.add_argument("folder", help="of `torchgrasp collect`")
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--export", metavar="DATASET", help=f"write it as a new dataset: {place}")
    action.add_argument("--import", dest="source", metavar="DATASET", help=f"make it from a dataset: {place}")
    action.add_argument(
        "--drop-damaged", action="store_true", help="delete the first damaged shard and those after it"
    )
    parser.add_argument(
        "--format", choices=_FORMATS, help="of the dataset: Minari's (default), or LeRobotDataset v3"
    )
    parser.add_argument(
        "--kind", help="with --import: of the demonstrations (expert, perturbed, failed, learner)"
    )


def run(args: argparse.Namespace) -> int:
    """Do what is asked for; every byte is checked before the card is printed."""
    from torchgrasp.data.demonstrations import drop_damaged_shards, open_demonstrations

    if args.kind is not None and args.source is None:
        raise ConfigError(
            f"--kind={args.kind} goes with --import alone: a folder keeps the kind that it has."
        )
    if args.format is not None and args.source is None and args.export is None:
        raise ConfigError(f"--format={args.format} goes with --export or --import: give one of them.")
    if args.source is not None:
        _, read = _find_exchange(args.format)
        read(args.source, args.folder, kind=args.kind)
    if args.drop_damaged:
        names = drop_damaged_shards(args.folder)
        again = f"{', '.join(names)} deleted: collect again to make them anew."
        print(again if names else "No shard is damaged, none was deleted.")
        return 0
    demonstrations = open_demonstrations(args.folder)
    print_card(demonstrations.card)
    if args.export is not None:
        write, _ = _find_exchange(args.format)
        print(f"Written to {write(demonstrations, args.export)}")
    return 0


def _find_exchange(name: str | None) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """What writes and what reads datasets of a format, Minari's if None."""
    if name == "lerobot":
        from torchgrasp.data.lerobot.exchange import export_lerobot, import_lerobot

        return export_lerobot, import_lerobot
    from torchgrasp.data.minari.exchange import export_minari, import_minari

    return export_minari, import_minari


def print_card(card: dict[str, Any]) -> None:
    """The card in lines, objects in a table; what its names hide from the eye is escaped."""
    plain = {name: value for name, value in card.items() if not isinstance(value, dict | list)}
    plain["seeds"] = ", ".join(map(str, card["seeds"]))
    plain["versions"] = ", ".join(f"{name} {'/'.join(each)}" for name, each in card["versions"].items())
    plain["provenance"] = ", ".join(card["provenance"]) or "not told"
    for name, value in plain.items():
        print(f"{name:18} {printable(value)}")
    objects = {printable(name): counts for name, counts in card["objects"].items()}
    width = max(map(len, objects), default=0)
    print(f"\n{'object':{width}}  episodes  successful")
    for name, counts in objects.items():
        print(f"{name:{width}}  {counts['episodes']:8}  {counts['successes']:10}")
    print("\nAll files are as they were written.")
