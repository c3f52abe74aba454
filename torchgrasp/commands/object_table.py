"""What a set of objects holds, what of it can be grasped, or why not: the table of `torchgrasp objects`."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from torchgrasp.errors import ConfigError, ObjectError, printable
from torchgrasp.names import one_line
from torchgrasp.objects import (
    AcronymObjects,
    FolderObjects,
    GraspObject,
    ObjectSet,
    ProceduralObjects,
    RandomUrdfObjects,
    YcbObjects,
)
from torchgrasp.objects.build import BUILD_VERSION
from torchgrasp.objects.gripper import MIN_CLEAR_GRASPS
from torchgrasp.objects.household import HOUSEHOLD
from torchgrasp.objects.packaged import INDEX_DIR, ObjectIndex, read_index
from torchgrasp.sim import Physics, prepare_resting, settled_poses
from torchgrasp.sim.reach import clear_grasps

_PACKAGED = {"ycb": YcbObjects, "random_urdfs": RandomUrdfObjects}


@dataclass(frozen=True)
class Row:
    """What the table says of one object; `reason` is empty where it can be grasped."""

    name: str
    licence: str
    reason: str
    size: str = "-"
    parts: int = 0
    grasps: int = 0
    resting: str = "-"


def print_table(args: argparse.Namespace) -> None:
    """Prepare the set, print its table and, last, what became of it."""
    objects = make_set(args)
    if args.write_index and (args.set not in _PACKAGED or args.split or args.limit):
        raise ConfigError("--write-index is for all of ycb or random_urdfs: leave --split and --limit out.")
    physics = Physics()
    prepare_resting(objects, physics, workers=args.workers)
    rows = [describe(objects, index, physics) for index in range(len(objects))]
    print_rows(rows)
    if args.write_index:
        write_index(args.set, rows)


def make_set(args: argparse.Namespace) -> ObjectSet:
    """The set that the options name, with what cannot be grasped in it."""
    common = {"num_objects": args.limit, "num_grasps": args.num_grasps, "workers": args.workers}
    if args.set == "procedural":
        return ProceduralObjects(args.split or "train", **common)
    if args.set == "household":
        return ProceduralObjects(args.split or "train", families=tuple(HOUSEHOLD), **common)
    if args.set in _PACKAGED:
        return _PACKAGED[args.set](args.split, usable_only=False, **common)
    if args.path is None:
        raise ConfigError(f"{args.set} needs --path: give the folder of the meshes.")
    if args.set == "acronym":
        return AcronymObjects(args.path, split=args.split, **common)
    options = {"scale": args.scale, "scale_table": args.scale_table, "resize": args.resize}
    return FolderObjects(args.path, split=args.split, **options, **common)


def describe(objects: ObjectSet, index: int, physics: Physics) -> Row:
    """One object's row."""
    name, licence = objects.names[index], objects.licence(index)
    try:
        item = objects[index]
    except ObjectError as error:
        return Row(name, licence, _short(str(error)))
    poses = settled_poses(item, physics)
    clear = sum(len(clear_grasps(item, pose)) >= MIN_CLEAR_GRASPS for pose in poses)
    return Row(
        name,
        licence,
        _why_not(len(poses), clear),
        size=_centimetres(item),
        parts=len(item.parts),
        grasps=len(item.grasps),
        resting=f"{clear}/{len(poses)}",
    )


def _why_not(resting: int, clear: int) -> str:
    if not resting:
        return "comes to rest in none of its poses"
    return (
        ""
        if clear
        else f"none of {resting} resting poses leaves {MIN_CLEAR_GRASPS} grasps clear of the table"
    )


def _centimetres(item: GraspObject) -> str:
    return " x ".join(f"{100 * side:.1f}" for side in item.size)


def _short(reason: str) -> str:
    """A refusal's first clause, without the folder that the file lies in."""
    words = [word.rsplit("/", 1)[-1] if word.startswith("/") else word for word in reason.split()]
    text = " ".join(words).split(" Give ")[0].split(" Leave ")[0].rstrip(".")
    return text


def print_rows(rows: list[Row]) -> None:
    """The table, its totals below."""
    names = [printable(row.name) for row in rows]
    width = max(map(len, names))
    print(f"{'name':{width}}  {'size (cm)':18} {'parts':>5} {'grasps':>6} {'rests':>5}  graspable, licence")
    for name, row in zip(names, rows, strict=True):
        verdict = f"no: {one_line(row.reason)}" if row.reason else "yes"
        print(
            f"{name:{width}}  {row.size:18} {row.parts:5} {row.grasps:6} {row.resting:>5}  {verdict};"
            f" {one_line(row.licence)}"
        )
    good = sum(not row.reason for row in rows)
    print(
        f"{good} of {len(rows)} objects can be grasped. rests: poses that leave grasps clear / proved poses"
    )


def write_index(kind: str, rows: list[Row]) -> None:
    """Store which objects of a package can be grasped, beside the code that reads it.

    An object that could be grasped before keeps its place; one that can be now comes after those.
    """
    before = [name for name, reason in read_index(kind).items() if not reason]
    rows = sorted(rows, key=lambda row: before.index(row.name) if row.name in before else len(before))
    objects = {row.name: row.reason for row in rows}
    INDEX_DIR.mkdir(exist_ok=True)
    index = ObjectIndex(build_version=BUILD_VERSION, objects=objects)
    (INDEX_DIR / f"{kind}.json").write_text(json.dumps(index.model_dump(), indent=0) + "\n")
