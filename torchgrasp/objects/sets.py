"""Sets of objects: built when first used, kept on disk, prepared ahead by several processes."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Literal, overload

import numpy as np

from torchgrasp.errors import ObjectError, check_whole
from torchgrasp.names import to_path
from torchgrasp.objects.cache import default_cache_dir, load_or_build, read_refusal
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.parallel import run_each

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")
MIN_GRASPS = 100  # the paper keeps 100 grasps an object (Sec. 6.1)
_IN_MEMORY = 512
_MOST_GRASPS = 100_000


class ObjectSet(Sequence[GraspObject], ABC):
    """A fixed sequence of GraspObjects, each built on first use and cached on disk.

    Subclasses name their objects and say how each is built; a set is cheap to construct and to send to
    other processes.

    Args:
        num_grasps: at most so many grasps an object, at least 100.
        cache_dir: where built objects are kept; by default `default_cache_dir()`.
        workers: processes that `prepare` uses unless told otherwise.
    """

    def __init__(self, *, num_grasps: int, cache_dir: str | Path | None, workers: int):
        check_whole("num_grasps", num_grasps, MIN_GRASPS, _MOST_GRASPS)
        check_whole("workers", workers, 1)
        self.num_grasps = num_grasps
        self.cache_dir = default_cache_dir() if cache_dir is None else to_path("cache_dir", cache_dir)
        self.workers = workers
        self._memory: OrderedDict[int, GraspObject] = OrderedDict()

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """The objects' names, in order, unique; nothing is built for them."""

    @abstractmethod
    def _cache_path(self, index: int) -> Path:
        """The file that holds the built object, named by all that decides its content."""

    @abstractmethod
    def _build(self, index: int) -> GraspObject:
        """The object, built from nothing; the same one in every process."""

    @abstractmethod
    def licence(self, index: int) -> str:
        """The licence of an object's shape; nothing is built for it."""

    def __len__(self) -> int:
        return len(self.names)

    @overload
    def __getitem__(self, index: int) -> GraspObject: ...
    @overload
    def __getitem__(self, index: slice) -> list[GraspObject]: ...
    def __getitem__(self, index: int | slice) -> GraspObject | list[GraspObject]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        position = range(len(self))[index]
        if position not in self._memory:
            self._memory[position] = self._load(position)
            while len(self._memory) > _IN_MEMORY:
                self._memory.popitem(last=False)
        return self._memory[position]

    def _load(self, index: int) -> GraspObject:
        return load_or_build(self._cache_path(index), lambda: self._build(index))

    def __iter__(self) -> Iterator[GraspObject]:
        return (self[index] for index in range(len(self)))

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_memory": OrderedDict()}

    def draw(self, rng: np.random.Generator) -> int:
        """An index for one episode, uniform over the set; the one place where objects are drawn."""
        return int(rng.integers(len(self)))

    def refusal(self, index: int) -> str | None:
        """Why the object cannot be used: its file cannot be read, or an earlier attempt to build it told."""
        try:
            return read_refusal(self._cache_path(index))
        except ObjectError as error:
            return str(error)

    def missing(self) -> list[int]:
        """Indices of the objects that are to be built: neither in the cache nor refused."""
        return [i for i in range(len(self)) if self.refusal(i) is None and not self._cache_path(i).exists()]

    def contents(self) -> dict[str, str]:
        """Name -> a digest of all that decides the object; nothing is built for it."""
        return {name: self._cache_path(index).stem for index, name in enumerate(self.names)}

    def obstacle(self) -> str | None:
        """Why objects that are not cached would be built each time anew here, None where they would not."""
        missing = len(self.missing())
        folder = next((each for each in (self.cache_dir, *self.cache_dir.parents) if each.exists()), None)
        writable = folder is not None and folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
        if not missing or writable:
            return None
        return (
            f"{missing} objects are not in the cache {self.cache_dir}, which cannot be written: "
            "set TORCHGRASP_CACHE, or cache_dir, to a directory that can."
        )

    def prepare(self, *, progress: bool = True, workers: int | None = None) -> None:
        """Build what the cache lacks, with a progress bar; nothing happens where all is there.

        Args:
            progress: show the bar.
            workers: processes to build with; None for the set's own `workers`. A set whose class is of the
                caller's script is built in this process.
        """
        build = partial(_build_into_cache, self)
        run_each(
            build,
            self.missing(),
            workers=workers or self.workers,
            label="building objects",
            progress=progress,
        )


def _build_into_cache(objects: ObjectSet, index: int) -> None:
    objects[index]
