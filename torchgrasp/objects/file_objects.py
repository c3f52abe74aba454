"""Sets whose objects come from mesh files: read, made physical, refused by name where that fails."""

from __future__ import annotations

import hashlib
import warnings
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from torchgrasp.errors import ConfigError, ObjectError, check_range
from torchgrasp.names import file_stem
from torchgrasp.objects.build import BUILD_VERSION, build_object
from torchgrasp.objects.cache import cache_key
from torchgrasp.objects.mesh_files import read_bytes
from torchgrasp.objects.meshes import READING_VERSION, read_solid
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.parallel import run_each
from torchgrasp.objects.sets import MIN_GRASPS, ObjectSet
from torchgrasp.objects.solids import Solid


@dataclass(frozen=True)
class Source:
    """A mesh file and what becomes of it.

    Attributes:
        name: of the object, unique in its set.
        file: the mesh.
        family: of the object.
        licence: of the shape.
        scale: factor from the file's unit to metres.
    """

    name: str
    file: Path
    family: str
    licence: str
    scale: float = 1.0


class FileObjects(ObjectSet):
    """Objects built from mesh files, each cached by its file's content.

    Args:
        sources: the files, in order.
        concavity: coacd's threshold for the convex parts, 0.01 (many) to 1 (one).
        resize: scale each object so that the hand can span it, see `meshes.hand_scale`.
        min_grasps: an object with fewer grasps than this cannot be used.
        num_grasps: at most so many grasps an object.
        cache_dir: where built objects are kept.
        workers: processes that `prepare` uses.
    """

    _remedy = "Give another scale=, resize=True, a lower min_grasps=, or on_error='skip'."

    def __init__(
        self,
        sources: Sequence[Source],
        *,
        concavity: float = 0.05,
        resize: bool = False,
        min_grasps: int = MIN_GRASPS,
        num_grasps: int = 400,
        cache_dir: str | Path | None = None,
        workers: int = 1,
    ):
        super().__init__(num_grasps=num_grasps, cache_dir=cache_dir, workers=workers)
        check_range("concavity", concavity, 0.01, 1.0)
        check_range("min_grasps", min_grasps, 1, num_grasps)
        self.concavity, self.resize, self.min_grasps = concavity, resize, min_grasps
        self._sources = tuple(sources)
        self._digests: dict[Path, str] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the sources."""
        return tuple(source.name for source in self._sources)

    def licence(self, index: int) -> str:
        """The licence of an object's shape, known before it is built."""
        return self._sources[index].licence

    def _digest(self, file: Path) -> str:
        """Of a file's content, or why it cannot be read: to build the object then fails with that."""
        if file not in self._digests:
            try:
                self._digests[file] = hashlib.sha256(read_bytes(file)).hexdigest()
            except ObjectError as error:
                return str(error)
        return self._digests[file]

    def _content(self, source: Source) -> tuple:
        """All that decides the shape: the file's bytes and how it is read."""
        return (self._digest(source.file), source.scale, self.concavity, self.resize)

    def _cache_path(self, index: int) -> Path:
        source = self._sources[index]
        told = (source.name, source.family, source.licence, self.num_grasps, self.min_grasps)
        versions = (BUILD_VERSION, READING_VERSION)
        key = cache_key(type(self).__name__, versions, self._content(source), told)
        return self.cache_dir / f"{file_stem(source.name)}-{key}.npz"

    def _solid(self, source: Source) -> Solid:
        return read_solid(source.file, scale=source.scale, concavity=self.concavity, resize=self.resize)

    def _assemble(self, source: Source, solid: Solid) -> GraspObject:
        # The seed leaves num_grasps out: a smaller grasp set is refused where a larger one is.
        seed = zlib.crc32(cache_key(source.name, self._content(source)).encode())
        return build_object(
            solid,
            name=source.name,
            family=source.family,
            licence=source.licence,
            num_grasps=self.num_grasps,
            rng=np.random.default_rng(seed),
        )

    def _build(self, index: int) -> GraspObject:
        source = self._sources[index]
        built = self._assemble(source, self._solid(source))
        if len(built.grasps) < self.min_grasps:
            sides = " x ".join(f"{100 * side:.1f}" for side in built.size)
            raise ObjectError(
                f"{source.file} has {len(built.grasps)} grasps where min_grasps={self.min_grasps} are needed:"
                f" it measures {sides} cm and the hand opens 8 cm. {self._remedy}"
            )
        return built

    def _skip_unusable(self, where: Path) -> None:
        """Build all, keep those that can be used, and warn of the others."""
        attempt, named = partial(_attempt, self), self.names.__getitem__
        run_each(attempt, self.missing(), workers=self.workers, label="building objects", name=named)
        usable = []
        for index, source in enumerate(self._sources):
            try:
                self[index]
                usable.append(source)
            except ObjectError as error:
                warnings.warn(f"Skipped: {error}", stacklevel=3)
        self._memory.clear()
        self._sources = tuple(usable)
        if not usable:
            raise ObjectError(f"No mesh in {where} can be used; each warning above says why.")


def _attempt(objects: FileObjects, index: int) -> None:
    with suppress(ObjectError):  # remembered by the cache
        objects[index]


def check_on_error(on_error: str) -> None:
    """Refuse what is neither raise nor skip."""
    if on_error not in ("raise", "skip"):
        raise ConfigError(f"on_error={on_error!r}: give 'raise' or 'skip'.")
