"""The default object set: parametric tabletop shapes, nothing to download, MIT."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchgrasp.errors import ConfigError, ObjectError, check_whole
from torchgrasp.objects.build import BUILD_VERSION, build_object, graspable_at_rest
from torchgrasp.objects.cache import cache_key
from torchgrasp.objects.families import FAMILIES, HELD_OUT, TRAINED
from torchgrasp.objects.household import HOUSEHOLD, LEAST_AT_REST
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.sets import MIN_GRASPS, SPLITS, ObjectSet, Split

_MOST_OBJECTS = 1_000_000  # their names are held in memory
_DEFAULT_SIZE: dict[Split, int] = {"train": 320, "val": 40, "test": 80}
_LICENCE = "MIT, procedural"
_ATTEMPTS = 20
_GRASPABLE = 0.5  # probability of resting so that the table leaves grasps
_ALL = {**FAMILIES, **HOUSEHOLD}


class ProceduralObjects(ObjectSet):
    """Objects whose sizes are drawn from ``(seed, split, family, index)``: splits share no object.

    The families take turns, so that a longer set begins with the shorter one's objects. Two families
    (hammer, dumbbell) occur in the test split only. A draw with fewer than 100 grasps, or none on the
    table in most of its resting poses, is drawn again; for wide and flat boxes (`household`) a tenth
    of the probability of rest is enough.

    Args:
        split: ``train``, ``val`` or ``test``.
        num_objects: how many; 320, 40 and 80 for the splits by default.
        seed: of the whole set.
        num_grasps: at most so many grasps an object.
        families: names to choose from, those of `household.HOUSEHOLD` among them; by default the
            split's of `families.FAMILIES` alone.
        cache_dir: where built objects are kept.
        workers: processes that `prepare` uses.

    >>> objects = ProceduralObjects("train", num_objects=10)
    >>> objects.names[0], objects.names[9]
    ('box-train-00000', 'cylinder-train-00001')
    """

    def __init__(
        self,
        split: Split = "train",
        *,
        num_objects: int | None = None,
        seed: int = 0,
        num_grasps: int = 400,
        families: Sequence[str] | None = None,
        cache_dir: str | Path | None = None,
        workers: int = 1,
    ):
        super().__init__(num_grasps=num_grasps, cache_dir=cache_dir, workers=workers)
        if split not in SPLITS:
            raise ConfigError(f"split={split!r}: give one of {', '.join(SPLITS)}.")
        if num_objects is not None:
            check_whole("num_objects", num_objects, 1, _MOST_OBJECTS)
        check_whole("seed", seed, 0)
        self.split: Split = split
        self.seed = seed
        self.families = _families(split, families)
        size = num_objects if num_objects is not None else _DEFAULT_SIZE[split]
        kinds = len(self.families)
        self._names = tuple(f"{self.families[i % kinds]}-{split}-{i // kinds:05d}" for i in range(size))

    @property
    def names(self) -> tuple[str, ...]:
        """``family-split-number``, in order."""
        return self._names

    def licence(self, index: int) -> str:
        """The same for all."""
        return _LICENCE

    def _entropy(self, index: int) -> tuple[int, int, int, int]:
        family = self.families[index % len(self.families)]
        number = index // len(self.families)
        return self.seed, SPLITS.index(self.split), zlib.crc32(family.encode()), number

    def _cache_path(self, index: int) -> Path:
        key = cache_key("procedural", BUILD_VERSION, self._entropy(index), self.num_grasps)
        return self.cache_dir / f"{self._names[index]}-{key}.npz"

    def _build(self, index: int) -> GraspObject:
        family = self.families[index % len(self.families)]
        for attempt in range(_ATTEMPTS):
            rng = np.random.default_rng(np.random.SeedSequence((*self._entropy(index), attempt)))
            built = build_object(
                _ALL[family](rng),
                name=self._names[index],
                family=family,
                licence=_LICENCE,
                num_grasps=self.num_grasps,
                rng=rng,
            )
            clear = graspable_at_rest(built)
            if len(built.grasps) >= MIN_GRASPS and clear >= LEAST_AT_REST.get(family, _GRASPABLE):
                return built
        raise ObjectError(
            f"{self._names[index]} found no shape that can be grasped in {_ATTEMPTS} draws:"
            f" report it, and leave {family!r} out of families= meanwhile."
        )


def _families(split: Split, chosen: Sequence[str] | None) -> tuple[str, ...]:
    """The families of a split, checked against those that it may hold."""
    usual = tuple(FAMILIES) if split == "test" else tuple(TRAINED)
    if chosen is None:
        return usual
    if isinstance(chosen, str) or not isinstance(chosen, Sequence):
        raise ConfigError(f"families={chosen!r}: give a list of names, such as [box].")
    allowed = (*usual, *HOUSEHOLD)
    for name in chosen:
        if name in HELD_OUT and split != "test":
            raise ConfigError(
                f"families has {name!r}, which is kept for split='test' alone: leave it out here."
            )
        if name not in allowed:
            raise ConfigError(f"families has {name!r}: choose from {', '.join(allowed)}.")
    if not chosen or len(set(chosen)) < len(chosen):
        raise ConfigError(f"families={list(chosen)}: give at least one, each once.")
    return tuple(chosen)
