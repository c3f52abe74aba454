"""ACRONYM (Eppner, Mousavian and Fox, 2021): the paper's own source of grasps (Sec. 6.1), extra ``acronym``.

ShapeNetSem meshes may not be passed on: a user lays them out as ``<path>/grasps/*.h5`` and
``<path>/meshes/<category>/<id>.obj``. An .h5 file scales its mesh to a size that the hand can grasp and
holds 2,000 grasps of it, each tried in a simulator (FleX).
"""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from torchgrasp.errors import ConfigError, ObjectError, check_whole
from torchgrasp.objects.build import assemble
from torchgrasp.objects.cache import cache_key
from torchgrasp.objects.file_objects import FileObjects, Source, check_on_error
from torchgrasp.objects.folder import split_of
from torchgrasp.objects.grasps import GraspCandidates, choose_grasps
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.sets import MIN_GRASPS, SPLITS, Split
from torchgrasp.objects.solids import Solid

# The files' gripper opens along x, this project's hand along y; both have their origin in the hand's
# flange and approach along z. The hand is symmetric: +90 and -90 degrees are the same grasp.
T_ACRONYM_EE = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


class AcronymObjects(FileObjects):
    """Objects of ACRONYM with those of its grasps that held in its simulator and that the hand can reach.

    Args:
        path: the folder that holds ``grasps`` and ``meshes``.
        split: only the files of that split, by a hash of their names (8 : 1 : 1); None for all.
        include: only these names (an .h5 file's without suffix), in this order.
        num_objects: the first so many of those; None for all.
        concavity: coacd's threshold for the convex parts, 0.01 (many) to 1 (one).
        on_error: ``raise`` an ObjectError when an object that cannot be used is first asked for, or
            ``skip`` it with a warning; skipping builds all objects at construction.
        min_grasps: an object with fewer grasps than this cannot be used.
        num_grasps: at most so many grasps an object.
        cache_dir: where built objects are kept.
        workers: processes that `prepare` uses.
    """

    _remedy = "Give a lower min_grasps=, or on_error='skip'."

    def __init__(
        self,
        path: str | Path,
        *,
        split: Split | None = None,
        include: Sequence[str] | None = None,
        num_objects: int | None = None,
        concavity: float = 0.05,
        on_error: Literal["raise", "skip"] = "raise",
        min_grasps: int = MIN_GRASPS,
        num_grasps: int = 400,
        cache_dir: str | Path | None = None,
        workers: int = 1,
    ):
        import_h5py()
        if split is not None and split not in SPLITS:
            raise ConfigError(f"split={split!r}: give one of {', '.join(SPLITS)}, or None for all files.")
        if num_objects is not None:
            check_whole("num_objects", num_objects, 1)
        check_on_error(on_error)
        self.path = Path(path).expanduser()
        files = _chosen(self.path, split, include)[:num_objects]
        sources = {file: _source_or_skip(self.path, file, on_error) for file in files}
        files = [file for file, source in sources.items() if source is not None]
        super().__init__(
            [source for source in sources.values() if source is not None],
            concavity=concavity,
            min_grasps=min_grasps,
            num_grasps=num_grasps,
            cache_dir=cache_dir,
            workers=workers,
        )
        self._grasp_files = {file.stem: file for file in files}
        if on_error == "skip":
            self._skip_unusable(self.path)

    def _content(self, source: Source) -> tuple:
        return (*super()._content(source), self._digest(self._grasp_files[source.name]))

    def _assemble(self, source: Source, solid: Solid) -> GraspObject:
        poses = read_grasps(self._grasp_files[source.name]) @ T_ACRONYM_EE
        seed = zlib.crc32(cache_key(source.name, self._content(source)).encode())

        def find(centred: Solid, centre: np.ndarray, resting: np.ndarray) -> GraspCandidates:
            moved = poses.copy()
            moved[:, :3, 3] -= centre
            return choose_grasps(
                moved,
                centred.vertices,
                centred.faces,
                centred.parts,
                count=self.num_grasps,
                rng=np.random.default_rng(seed),
                resting=resting,
            )

        return assemble(solid, find, name=source.name, family=source.family, licence=source.licence)


def import_h5py() -> Any:
    """The module h5py; ConfigError names the extra where it is missing."""
    try:
        import h5py
    except ImportError as error:
        raise ConfigError('h5py is not installed: pip install "torchgrasp[acronym]".') from error
    return h5py


def read_grasps(file: Path, *, successful: bool = True) -> np.ndarray:
    """(B, 4, 4) grasps of the scaled mesh, in ACRONYM's own hand frame.

    Args:
        file: an .h5 file.
        successful: those that held in FleX, otherwise those that did not.
    """
    poses = np.asarray(_read(file, "grasps/transforms"), np.float64)
    held = np.asarray(_read(file, "grasps/qualities/flex/object_in_gripper")).ravel() > 0
    if poses.shape[1:] != (4, 4) or len(poses) != len(held) or not np.isfinite(poses).all():
        raise ObjectError(
            f"{file} has grasps/transforms of shape {poses.shape}: (N, 4, 4) finite ones are read."
        )
    return poses[held == successful]


def _read(file: Path, key: str) -> Any:
    h5py = import_h5py()
    try:
        with h5py.File(file, "r") as opened:
            return opened[key][()]
    except (OSError, KeyError) as error:
        raise ObjectError(
            f"{file} has no {key} that can be read ({error}): fetch it again or remove it."
        ) from error


def _source(path: Path, file: Path) -> Source:
    """The mesh that a grasp file names, and its scale to metres."""
    named = _read(file, "object/file")
    named = named.decode() if isinstance(named, bytes) else str(named)
    scale = float(_read(file, "object/scale"))
    mesh = (path / named).resolve()
    if not mesh.is_relative_to(path.resolve()):
        raise ObjectError(f"{file} names a mesh outside {path}: {named}.")
    if not mesh.is_file():
        raise ObjectError(f"{file} needs {path / named}: put the ShapeNetSem mesh there, or remove the file.")
    if not 0.0 < scale < float("inf"):
        raise ObjectError(f"{file} has object/scale={scale}: a positive factor is expected.")
    return Source(file.stem, path / named, Path(named).parent.name, "CC BY-NC 4.0", scale)


def _source_or_skip(path: Path, file: Path, on_error: str) -> Source | None:
    """What `_source` returns; None, with a warning, where it fails and failures are skipped."""
    try:
        return _source(path, file)
    except ObjectError as error:
        if on_error == "raise":
            raise
        warnings.warn(f"Skipped: {error}", stacklevel=3)
        return None


def _chosen(path: Path, split: Split | None, include: Sequence[str] | None) -> list[Path]:
    folder = path / "grasps"
    files = {file.stem: file for file in sorted(folder.glob("*.h5"))}
    if not files:
        raise ObjectError(
            f"{folder} holds no .h5 file: path= names the folder with grasps/ and meshes/ in it."
        )
    for name in include or ():
        if name not in files:
            raise ObjectError(f"include has {name!r}, but {folder} holds {', '.join(list(files)[:20])}.")
    chosen = [files[name] for name in (include if include is not None else files)]
    chosen = [file for file in chosen if split is None or split_of(file.stem) == split]
    if not chosen:
        raise ObjectError(f"No file in {folder} is left for split={split!r}: give split=None for all.")
    return chosen
