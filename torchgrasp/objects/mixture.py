"""Several object sets as one, each drawn with a weight of its own."""

from __future__ import annotations

import dataclasses
from bisect import bisect_right
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.sets import ObjectSet


class MixtureObjects(ObjectSet):
    """Sets side by side: `draw` chooses the set by its weight, then uniformly within it.

    Objects are named ``<set>/<name>``.

    Args:
        sets: the sets by name.
        weights: positive numbers for the same names, of any sum; equal by default. A set of ten objects
            and one of a thousand are drawn equally often then.
        workers: processes that `prepare` uses.

    >>> from torchgrasp.objects import ProceduralObjects
    >>> boxes = ProceduralObjects("train", num_objects=2, families=["box"])
    >>> bowls = ProceduralObjects("train", num_objects=1, families=["bowl"])
    >>> mixture = MixtureObjects({"boxes": boxes, "bowls": bowls}, weights={"boxes": 1, "bowls": 3})
    >>> mixture.names
    ('boxes/box-train-00000', 'boxes/box-train-00001', 'bowls/bowl-train-00000')
    """

    def __init__(
        self,
        sets: Mapping[str, ObjectSet],
        *,
        weights: Mapping[str, float] | None = None,
        workers: int = 1,
    ):
        if not sets:
            raise ConfigError("sets is empty: give at least one object set by its name.")
        if weights is not None and set(weights) != set(sets):
            raise ConfigError(f"weights names {', '.join(weights)}: give one for each of {', '.join(sets)}.")
        for name, objects in sets.items():
            check_range(f"weights[{name!r}]", 1 if weights is None else weights[name], 0, 1e9, open_low=True)
            if not len(objects):
                raise ConfigError(f"sets[{name!r}] is empty: leave it out.")
        first = next(iter(sets.values()))
        super().__init__(
            num_grasps=min(each.num_grasps for each in sets.values()),
            cache_dir=first.cache_dir,
            workers=workers,
        )
        self.sets = dict(sets)
        self._members = tuple(self.sets.values())
        self._ends = np.cumsum([len(each) for each in self._members]).tolist()
        shares = np.array([1.0 if weights is None else weights[name] for name in sets], np.float64)
        self._until = np.cumsum(shares / shares.sum())
        self._names = tuple(f"{key}/{name}" for key, each in sets.items() for name in each.names)

    @property
    def names(self) -> tuple[str, ...]:
        """``<set>/<name>``, set by set."""
        return self._names

    def draw(self, rng: np.random.Generator) -> int:
        """An index: a set by weight, then uniform in it."""
        chosen = min(int(np.searchsorted(self._until, rng.random(), side="right")), len(self._members) - 1)
        return self._ends[chosen] - len(self._members[chosen]) + self._members[chosen].draw(rng)

    def _member(self, index: int) -> tuple[ObjectSet, int]:
        """The set that holds an object, and the object's index in it."""
        chosen = bisect_right(self._ends, index)
        return self._members[chosen], index - self._ends[chosen] + len(self._members[chosen])

    def _cache_path(self, index: int) -> Path:
        objects, inner = self._member(index)
        return objects._cache_path(inner)

    def licence(self, index: int) -> str:
        """The licence of an object's shape."""
        objects, inner = self._member(index)
        return objects.licence(inner)

    def _load(self, index: int) -> GraspObject:
        objects, inner = self._member(index)
        return dataclasses.replace(objects._load(inner), name=self._names[index])

    def _build(self, index: int) -> GraspObject:
        objects, inner = self._member(index)
        return objects._build(inner)
