"""Sets of objects: built when first used, kept on disk, prepared ahead by several processes."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Literal, overload

import numpy as np
from tqdm import tqdm

from torchgrasp.errors import ConfigError
from torchgrasp.objects.cache import default_cache_dir, load_or_build
from torchgrasp.objects.model import GraspObject

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")
MIN_GRASPS = 100  # the paper keeps 100 grasps an object (Sec. 6.1)
_IN_MEMORY = 512


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
        if num_grasps < MIN_GRASPS:
            raise ConfigError(
                f"num_grasps={num_grasps} is too few: give {MIN_GRASPS} or more (400 is usual)."
            )
        if workers < 1:
            raise ConfigError(f"workers={workers}: give the number of building processes, 1 or more.")
        self.num_grasps = num_grasps
        self.cache_dir = Path(cache_dir).expanduser() if cache_dir is not None else default_cache_dir()
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
            item = load_or_build(self._cache_path(position), lambda: self._build(position))
            self._memory[position] = item
            while len(self._memory) > _IN_MEMORY:
                self._memory.popitem(last=False)
        return self._memory[position]

    def draw(self, rng: np.random.Generator) -> int:
        """The index of an object for one episode, uniform over the set."""
        return int(rng.integers(len(self)))

    def __iter__(self) -> Iterator[GraspObject]:
        return (self[index] for index in range(len(self)))

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_memory": OrderedDict()}

    def prepare(self, *, progress: bool = True, workers: int | None = None) -> None:
        """Build what the cache lacks, with a progress bar; nothing happens where all is there.

        Args:
            progress: show the bar.
            workers: processes to build with. More than one needs a script guarded by
                ``if __name__ == "__main__":``, as always with spawned processes; without it the
                objects are built in this process, with a warning.
        """
        missing = [index for index in range(len(self)) if not self._cache_path(index).exists()]
        if not missing:
            return
        workers = min(workers or self.workers, len(missing))
        with tqdm(total=len(missing), desc="building objects", disable=None if progress else True) as bar:
            if workers > 1:
                try:
                    self._prepare_in_processes(missing, workers, bar)
                    return
                except BrokenProcessPool:
                    warnings.warn(
                        "The building processes died or could not start (a script without"
                        " 'if __name__ == \"__main__\":'?): the objects are built in this process.",
                        stacklevel=2,
                    )
            for index in missing:
                if not self._cache_path(index).exists():
                    self[index]
                    bar.update()

    def _prepare_in_processes(self, missing: list[int], workers: int, bar: tqdm) -> None:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            futures = [pool.submit(_build_into_cache, self, index) for index in missing]
            try:
                for future in as_completed(futures):
                    future.result()
                    bar.update()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


def _build_into_cache(objects: ObjectSet, index: int) -> None:
    objects[index]
