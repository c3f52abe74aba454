"""Objects from a folder of mesh files: anybody's own, prepared like the procedural ones."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from torchgrasp.errors import ConfigError, ObjectError, check_range, check_whole
from torchgrasp.objects.file_objects import FileObjects, Source, check_on_error
from torchgrasp.objects.meshes import MESH_SUFFIXES
from torchgrasp.objects.scales import read_scales
from torchgrasp.objects.sets import MIN_GRASPS, SPLITS, Split


class FolderObjects(FileObjects):
    """Every obj, stl, ply, glb and off file below a folder, named by its path without the suffix.

    Args:
        path: the folder.
        split: only the files of that split, by a hash of their names (8 : 1 : 1); None for all.
        include: only these names, in this order; a test list, for example.
        num_objects: the first so many of those; None for all.
        scale: factor from the files' unit to metres.
        scale_table: a CSV (``name,scale`` lines) or YAML (``name: scale``) file with the factors of
            single objects; `scale` holds for the rest.
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
        check_range("scale", scale, 0.0, float("inf"), open_low=True)
        if num_objects is not None:
            check_whole("num_objects", num_objects, 1)
        if split is not None and split not in SPLITS:
            raise ConfigError(f"split={split!r}: give one of {', '.join(SPLITS)}, or None for all files.")
        check_on_error(on_error)
        self.path = Path(path).expanduser()
        named = _named(_mesh_files(self.path), self.path)
        scales = read_scales(scale_table, tuple(named)) if scale_table is not None else {}
        chosen = list(_choose(named, self.path, split, include).items())[:num_objects]
        super().__init__(
            [Source(name, file, self.path.name, licence, scales.get(name, scale)) for name, file in chosen],
            concavity=concavity,
            resize=resize,
            min_grasps=min_grasps,
            num_grasps=num_grasps,
            cache_dir=cache_dir,
            workers=workers,
        )
        if on_error == "skip":
            self._skip_unusable(self.path)


def _mesh_files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise ObjectError(f"{folder} is not a directory: give the folder that holds the mesh files.")
    files = sorted(file for file in folder.rglob("*") if file.suffix.lower() in MESH_SUFFIXES)
    if not files:
        raise ObjectError(f"{folder} holds no mesh file: {', '.join(MESH_SUFFIXES)} are read.")
    return files


def _named(files: list[Path], folder: Path) -> dict[str, Path]:
    """Names to files; two files that differ in their suffix alone keep it in their names."""
    stems = [file.relative_to(folder).with_suffix("").as_posix() for file in files]
    count = Counter(stems)
    return {
        stem if count[stem] == 1 else file.relative_to(folder).as_posix(): file
        for stem, file in zip(stems, files, strict=True)
    }


def _choose(
    named: dict[str, Path], folder: Path, split: Split | None, include: Sequence[str] | None
) -> dict[str, Path]:
    if include is not None:
        for name in include:
            if name not in named:
                raise ObjectError(f"include has {name!r}, but {folder} holds {', '.join(list(named)[:20])}.")
        named = {name: named[name] for name in include}
    if split is not None:
        named = {name: file for name, file in named.items() if split_of(name) == split}
    if not named:
        raise ObjectError(f"No mesh in {folder} is left for split={split!r}: give split=None for all.")
    return named


def split_of(name: str) -> Split:
    """The split of a name, the same on every machine."""
    bucket = zlib.crc32(name.encode()) % 10
    return "train" if bucket < 8 else "val" if bucket == 8 else "test"
