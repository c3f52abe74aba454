"""``torchgrasp objects <set>``: what a set holds, what of it can be grasped, or why not."""

from __future__ import annotations

import argparse

HELP = "build a set of objects and list which of them can be grasped"
SETS = ("procedural", "household", "ycb", "random_urdfs", "folder", "acronym")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("set", choices=SETS)
    parser.add_argument("--path", help="folder of the meshes (folder, acronym)")
    parser.add_argument("--split", help="train, val or test (ycb: train, test or others); all by default")
    parser.add_argument("--scale", type=float, default=1.0, help="factor to metres (folder)")
    parser.add_argument("--scale-table", help="CSV or YAML file of name,scale (folder)")
    parser.add_argument("--resize", action="store_true", help="scale objects to the hand (folder)")
    parser.add_argument("--limit", type=int, help="the first so many objects alone")
    parser.add_argument("--num-grasps", type=int, default=400, help="at most so many grasps an object")
    parser.add_argument("--workers", type=int, default=1, help="building processes")
    parser.add_argument("--write-index", action="store_true", help="for developers: renew the packaged index")


def run(args: argparse.Namespace) -> int:
    """Prepare the set, print its table and, last, what became of it."""
    from torchgrasp.commands.object_table import print_table

    print_table(args)
    return 0
