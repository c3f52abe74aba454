"""Objects from a folder of mesh files: anybody's own, prepared like the procedural ones."""

from __future__ import annotations

import unicodedata
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from torchgrasp.errors import ConfigError, ObjectError, check_range, check_whole
from torchgrasp.names import object_name, to_path
from torchgrasp.objects.file_objects import FileObjects, Source, check_on_error
from torchgrasp.objects.folder_listing import find_meshes, names_in_full
from torchgrasp.objects.scales import GREATEST, LEAST, read_scales
from torchgrasp.objects.sets import MIN_GRASPS, SPLITS, Split


class FolderObjects(FileObjects):
    """Every obj, stl, ply, glb and off file below a folder; `find_meshes` tells how they are named.

    Args:
        path: the folder.
        split: only the files of that split, by a hash of their names (8 : 1 : 1); None for all.
        include: only these names, in this order, with or without the suffix; a test list, for example.
        num_objects: the first so many of those; None for all.
        scale: factor from the files' unit to metres.
        scale_table: a CSV (``name,scale`` lines) or YAML (``name: scale``) file with the factors of
            single objects, see `read_scales`; `scale` holds for the rest.
        resize: scale each object so that the hand can span it, see `meshes.hand_scale`.
        licence: of the meshes; it travels with each object.
        concavity: coacd's threshold for the convex parts, 0.01 (many) to 1 (one).
        on_error: ``raise`` an ObjectError when a mesh that cannot be used is first asked for, or
            ``skip`` it with a warning; skipping builds all objects at construction.
        min_grasps: an object with fewer grasps than this cannot be used.
        num_grasps: at most so many grasps an object.
        cache_dir: where built objects are kept.
        workers: processes that `prepare` uses.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: Split | None = None,
        include: Sequence[str] | None = None,
        num_objects: int | None = None,
        scale: float = 1.0,
        scale_table: str | Path | None = None,
        resize: bool = False,
        licence: str = "unknown",
        concavity: float = 0.05,
        on_error: Literal["raise", "skip"] = "raise",
        min_grasps: int = MIN_GRASPS,
        num_grasps: int = 400,
        cache_dir: str | Path | None = None,
        workers: int = 1,
    ):
        check_range("scale", scale, LEAST, GREATEST)
        if num_objects is not None:
            check_whole("num_objects", num_objects, 1)
        if split is not None and split not in SPLITS:
            raise ConfigError(f"split={split!r}: give one of {', '.join(SPLITS)}, or None for all files.")
        check_on_error(on_error)
        self.path = to_path("path", path)
        named = find_meshes(self.path)
        called = names_in_full(named, self.path)
        scales = read_scales(scale_table, called) if scale_table is not None else {}
        if include is not None and not isinstance(include, str):
            include = [called.get(unicodedata.normalize("NFC", str(name)), str(name)) for name in include]
        chosen = list(choose(named, self.path, split=split, include=include).items())[:num_objects]
        family = object_name(Path(self.path.name))
        super().__init__(
            [Source(name, file, family, licence, scales.get(name, scale)) for name, file in chosen],
            concavity=concavity,
            resize=resize,
            min_grasps=min_grasps,
            num_grasps=num_grasps,
            cache_dir=cache_dir,
            workers=workers,
        )
        if on_error == "skip":
            self._skip_unusable(self.path)


def choose(
    named: dict[str, Path], folder: Path, *, split: Split | None, include: Sequence[str] | None
) -> dict[str, Path]:
    """Those of a folder's files that `include` and `split` leave, by name.

    Raises:
        ConfigError: where `include` is no list of names.
        ObjectError: where a name of `include` is not there, or nothing is left.
    """
    if include is not None:
        if isinstance(include, str) or not include:
            raise ConfigError(f"include={include!r}: give a list of names, or None for all files.")
        for name in include:
            if name not in named:
                known = ", ".join(named)[:400]
                raise ObjectError(f"include has {name!r}, but {folder} holds {known}: give names of these.")
        named = {name: named[name] for name in include}
    if split is not None:
        named = {name: file for name, file in named.items() if split_of(name) == split}
    if not named:
        raise ObjectError(f"No file in {folder} is left for split={split!r}: give split=None for all.")
    return named


def split_of(name: str) -> Split:
    """The split of a name, the same on every machine."""
    bucket = zlib.crc32(name.encode()) % 10
    return "train" if bucket < 8 else "val" if bucket == 8 else "test"
