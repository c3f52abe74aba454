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
from reprlib import repr as short
from typing import Any, Literal

import numpy as np

from torchgrasp.errors import ConfigError, ObjectError, check_whole
from torchgrasp.names import object_name, one_line, to_path
from torchgrasp.objects.build import assemble
from torchgrasp.objects.cache import cache_key
from torchgrasp.objects.candidates import GraspCandidates
from torchgrasp.objects.file_objects import FileObjects, Source, check_on_error
from torchgrasp.objects.folder import choose
from torchgrasp.objects.grasps import choose_grasps
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.scales import GREATEST, LEAST
from torchgrasp.objects.sets import MIN_GRASPS, SPLITS, Split
from torchgrasp.objects.solids import Solid

# The files' gripper opens along x, this project's hand along y; both have their origin in the hand's
# flange and approach along z. The hand is symmetric: +90 and -90 degrees are the same grasp.
T_ACRONYM_EE = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
# Of a file of 2,000 grasps the largest data set has 256 kB.
_MOST_BYTES = 100_000_000


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
        self.path = to_path("path", path)
        named = choose(_grasp_files(self.path), self.path / "grasps", split=split, include=include)
        files = list(named.values())[:num_objects]
        found = {file: _source_or_skip(self.path, file, on_error) for file in files}
        sources = {file: source for file, source in found.items() if source is not None}
        super().__init__(
            list(sources.values()),
            concavity=concavity,
            min_grasps=min_grasps,
            num_grasps=num_grasps,
            cache_dir=cache_dir,
            workers=workers,
        )
        self._grasp_files = {source.name: file for file, source in sources.items()}
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
    poses = _read_numbers(file, "grasps/transforms")
    held = _read_numbers(file, "grasps/qualities/flex/object_in_gripper").ravel() > 0
    if poses.shape[1:] != (4, 4) or len(poses) != len(held) or not np.isfinite(poses).all():
        raise ObjectError(
            f"{file} has grasps/transforms of shape {poses.shape}: (N, 4, 4) finite ones are read."
        )
    return poses[held == successful]


def _read_numbers(file: Path, key: str) -> np.ndarray:
    """The array of numbers that stands under a key."""
    found = _read(file, key)
    try:
        return np.asarray(found, np.float64)
    except (TypeError, ValueError) as error:
        raise ObjectError(f"{file} has a {key} that is no number: fetch it again or remove it.") from error


def _read(file: Path, key: str) -> Any:
    """What stands under a key; ObjectError where it cannot be read, is huge, or lies in another file."""
    h5py = import_h5py()
    try:
        with h5py.File(file, "r") as opened:
            found = opened[key]
            if not isinstance(found, h5py.Dataset):
                raise KeyError("it is no data set")
            if found.external or found.is_virtual or found.file.filename != opened.filename:
                raise OSError("it lies in another file")
            if found.nbytes > _MOST_BYTES:
                raise OSError(f"it would take {found.nbytes / 1e6:.0f} MB")
            return found[()]
    except (OSError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise ObjectError(
            f"{file} has no {key} that can be read ({error}): fetch it again or remove it."
        ) from error


def _source(path: Path, file: Path) -> Source:
    """The mesh that a grasp file names, and its scale to metres."""
    mesh, scale = _mesh(path, file), _read_numbers(file, "object/scale")
    if scale.size != 1 or not LEAST <= scale.item() <= GREATEST:
        raise ObjectError(
            f"{file} has object/scale={short(scale)}: one factor of at most {GREATEST:g} is read."
        )
    return Source(
        object_name(Path(file.stem)), mesh, object_name(Path(mesh.parent.name)), "CC BY-NC 4.0", scale.item()
    )


def _mesh(path: Path, file: Path) -> Path:
    """The mesh file that a grasp file names, below `path`."""
    named = _read(file, "object/file")
    try:
        named = named.decode() if isinstance(named, bytes) else str(named)
        # By its words alone: folders may be links to another disk.
        inside = not Path(named).is_absolute() and ".." not in Path(named).parts
        there = (path / named).is_file()
    except (OSError, ValueError) as error:
        raise ObjectError(
            f"{file} names a mesh by {short(named)}, which is no path ({error}): fetch it again."
        ) from error
    if not inside:
        raise ObjectError(f"{file} names a mesh outside {path}: {named}.")
    if not there:
        raise ObjectError(f"{file} needs {path / named}: put the ShapeNetSem mesh there, or remove the file.")
    return path / named


def _source_or_skip(path: Path, file: Path, on_error: str) -> Source | None:
    """What `_source` returns; None, with a warning, where it fails and failures are skipped."""
    try:
        return _source(path, file)
    except ObjectError as error:
        if on_error == "raise":
            raise
        warnings.warn(one_line(f"Skipped: {error}"), stacklevel=3)
        return None


def _grasp_files(path: Path) -> dict[str, Path]:
    """The .h5 files by their objects' names."""
    folder = path / "grasps"
    files = sorted(file for file in folder.glob("*.h5") if not file.name.startswith("."))
    if not files:
        raise ObjectError(
            f"{folder} holds no .h5 file: path= names the folder with grasps/ and meshes/ in it."
        )
    return {object_name(Path(file.stem)): file for file in files}
