"""Objects from a folder of mesh files: anybody's own, prepared like the procedural ones."""

from __future__ import annotations

import contextlib
import hashlib
import warnings
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from torchgrasp.errors import ConfigError, ObjectError, check_range
from torchgrasp.objects.build import BUILD_VERSION, build_object
from torchgrasp.objects.cache import cache_key
from torchgrasp.objects.meshes import MESH_SUFFIXES, read_solid
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.sets import MIN_GRASPS, SPLITS, ObjectSet, Split


class FolderObjects(ObjectSet):
    """Every obj, stl, ply, glb and off file below a folder, named by its path without the suffix.

    Args:
        path: the folder.
        split: only the files of that split, by a hash of their names (8 : 1 : 1); None for all.
        include: only these names, in this order; a test list, for example.
        num_objects: the first so many of those; None for all.
        scale: factor from the files' unit to metres.
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
        licence: str = "unknown",
        concavity: float = 0.05,
        on_error: Literal["raise", "skip"] = "raise",
        min_grasps: int = MIN_GRASPS,
        num_grasps: int = 400,
        cache_dir: str | Path | None = None,
        workers: int = 1,
    ):
        super().__init__(num_grasps=num_grasps, cache_dir=cache_dir, workers=workers)
        check_range("scale", scale, 0.0, float("inf"), open_low=True)
        check_range("concavity", concavity, 0.01, 1.0)
        if num_objects is not None:
            check_range("num_objects", num_objects, 1, float("inf"))
        check_range("min_grasps", min_grasps, 1, num_grasps)
        if split is not None and split not in SPLITS:
            raise ConfigError(f"split={split!r}: give one of {', '.join(SPLITS)}, or None for all files.")
        if on_error not in ("raise", "skip"):
            raise ConfigError(f"on_error={on_error!r}: give 'raise' or 'skip'.")
        self.path = Path(path).expanduser()
        self.scale, self.licence, self.concavity, self.min_grasps = scale, licence, concavity, min_grasps
        files = _choose(_mesh_files(self.path), self.path, split, include)
        self._names, self._files = tuple(files)[:num_objects], tuple(files.values())[:num_objects]
        self._digests: dict[Path, str] = {}
        if on_error == "skip":
            self._skip_unusable()

    @property
    def names(self) -> tuple[str, ...]:
        """Paths below the folder without suffix, sorted, or in the order of `include`."""
        return self._names

    def _cache_path(self, index: int) -> Path:
        name, file = self._names[index], self._files[index]
        if file not in self._digests:
            self._digests[file] = hashlib.sha256(file.read_bytes()).hexdigest()
        settings = (self.scale, self.concavity, self.num_grasps, self.min_grasps, self.licence)
        key = cache_key("folder", BUILD_VERSION, name, self.path.name, self._digests[file], settings)
        return self.cache_dir / f"{Path(name).name}-{key}.npz"

    def _build(self, index: int) -> GraspObject:
        file = self._files[index]
        built = build_object(
            read_solid(file, scale=self.scale, concavity=self.concavity),
            name=self._names[index],
            family=self.path.name,
            licence=self.licence,
            num_grasps=self.num_grasps,
            rng=np.random.default_rng(zlib.crc32(self._cache_path(index).name.encode())),
        )
        if len(built.grasps) < self.min_grasps:
            sides = " x ".join(f"{100 * side:.1f}" for side in built.size)
            raise ObjectError(
                f"{file} has {len(built.grasps)} grasps where min_grasps={self.min_grasps} are needed: it"
                f" measures {sides} cm and the hand opens 8 cm. Give another scale=, a lower min_grasps=,"
                " or on_error='skip'."
            )
        return built

    def _skip_unusable(self) -> None:
        """Keep the objects that can be built; why another cannot is remembered beside the cache."""
        usable = []
        for index in range(len(self._names)):
            refused = self._cache_path(index).with_suffix(".refused")
            try:
                if refused.exists():
                    raise ObjectError(refused.read_text())
                self[index]
                usable.append(index)
            except ObjectError as error:
                warnings.warn(f"Skipped: {error}", stacklevel=3)
                with contextlib.suppress(OSError):  # an unwritable cache only costs the next attempt
                    refused.parent.mkdir(parents=True, exist_ok=True)
                    refused.write_text(str(error))
        self._memory.clear()
        self._names = tuple(self._names[index] for index in usable)
        self._files = tuple(self._files[index] for index in usable)
        if not usable:
            raise ObjectError(f"No mesh in {self.path} can be used; each warning above says why.")


def _mesh_files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise ObjectError(f"{folder} is not a directory: give the folder that holds the mesh files.")
    files = sorted(file for file in folder.rglob("*") if file.suffix.lower() in MESH_SUFFIXES)
    if not files:
        raise ObjectError(f"{folder} holds no mesh file: {', '.join(MESH_SUFFIXES)} are read.")
    return files


def _choose(
    files: list[Path], folder: Path, split: Split | None, include: Sequence[str] | None
) -> dict[str, Path]:
    """Names to files; two files that differ in their suffix alone keep it in their names."""
    stems = [file.relative_to(folder).with_suffix("").as_posix() for file in files]
    count = Counter(stems)
    named = {
        stem if count[stem] == 1 else file.relative_to(folder).as_posix(): file
        for stem, file in zip(stems, files, strict=True)
    }
    if include is not None:
        for name in include:
            if name not in named:
                raise ObjectError(f"include has {name!r}, but {folder} holds {', '.join(list(named)[:20])}.")
        named = {name: named[name] for name in include}
    if split is not None:
        named = {name: file for name, file in named.items() if _split_of(name) == split}
    if not named:
        raise ObjectError(f"No mesh in {folder} is left for split={split!r}: give split=None for all.")
    return named


def _split_of(name: str) -> Split:
    """The split of a name, the same on every machine."""
    bucket = zlib.crc32(name.encode()) % 10
    return "train" if bucket < 8 else "val" if bucket == 8 else "test"
