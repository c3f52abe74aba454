"""Sets whose meshes come with a Python package: which of the objects the hand can use is known ahead.

A small index beside the code lists each object as usable or says why it is not, so that a set is cheap
to construct and never meets an object that cannot be grasped. `python -m torchgrasp objects <set>
--write-index` makes it.
"""

from __future__ import annotations

import functools
import importlib.util
import warnings
from collections.abc import Sequence
from pathlib import Path

from torchgrasp.documents import Count, Document, Name, Text, read_document
from torchgrasp.errors import ConfigError, ObjectError, check_whole
from torchgrasp.objects.file_objects import FileObjects, Source
from torchgrasp.objects.solids import Solid

INDEX_DIR = Path(__file__).parent / "data"


class ObjectIndex(Document):
    """The index of a package's objects: why each is unusable, or nothing."""

    build_version: Count
    objects: dict[Name, Text]


def package_folder(package: str, extra: str) -> Path:
    """The folder of an installed package, which is not imported; ConfigError names the extra."""
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise ConfigError(f'{package} is not installed: pip install "torchgrasp[{extra}]".')
    return Path(next(iter(found.submodule_search_locations)))


@functools.cache
def read_index(kind: str) -> dict[str, str]:
    """Why an object is unusable, by name; empty text for those that are usable, nothing where unknown.

    Usable ones stand in the order in which sets hold them: one that became usable later comes last, so
    that the others keep their numbers.
    """
    file = INDEX_DIR / f"{kind}.json"
    return (
        read_document(file, ObjectIndex, "install torchgrasp again", error=ObjectError).objects
        if file.exists()
        else {}
    )


class PackagedObjects(FileObjects):
    """The usable ones of a package's objects.

    Args:
        sources: all of the split's objects.
        kind: the index's name.
        num_objects: the first so many of the usable ones; None for all.
        usable_only: leave out what the index says cannot be grasped. Otherwise such an object raises
            an ObjectError when it is asked for.
        concavity, num_grasps, cache_dir, workers: see `FileObjects`.
    """

    _remedy = "Leave usable_only=True, which passes it over."

    def __init__(
        self,
        sources: Sequence[Source],
        *,
        kind: str,
        num_objects: int | None,
        usable_only: bool,
        concavity: float,
        num_grasps: int,
        cache_dir: str | Path | None,
        workers: int,
    ):
        if num_objects is not None:
            check_whole("num_objects", num_objects, 1)
        if usable_only:
            sources = _usable(sources, read_index(kind))
        super().__init__(
            sources[:num_objects],
            concavity=concavity,
            num_grasps=num_grasps,
            cache_dir=cache_dir,
            workers=workers,
        )

    def _solid(self, source: Source) -> Solid:
        with warnings.catch_warnings():  # nobody can mend a package's meshes: that a scan is open is known
            warnings.simplefilter("ignore")
            return super()._solid(source)


def _usable(sources: Sequence[Source], index: dict[str, str]) -> list[Source]:
    """The usable sources in the order of the index, those that it does not know last."""
    place = {name: number for number, name in enumerate(index)}
    usable = [source for source in sources if not index.get(source.name)]
    return sorted(usable, key=lambda source: place.get(source.name, len(place)))
