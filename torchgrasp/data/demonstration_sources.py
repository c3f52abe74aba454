"""Demonstrations as sources of the replay buffer: D_expert, and what is configured beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.data.demonstration_card import read_card
from torchgrasp.data.demonstration_kinds import COUNTED, check_kind, find_counted, resolve_count
from torchgrasp.errors import ConfigError, check_range, check_whole

# Sources that episodes go to, or D_expert: names that further demonstrations cannot have.
_TAKEN = ("online", "hindsight", "expert")
_DEFAULTS: dict[str, Any] = {
    **{"count": None, "path": None, "policy": None, "weight": None},
    **{"expert_start": False, "labels": True},
}
_OPTIONS = ("kind", "steps", *_DEFAULTS)


@dataclass(frozen=True)
class Source:
    """A folder of demonstrations that batches are drawn from.

    Attributes:
        name: of the source in the replay buffer.
        path: the folder.
        count: which of its episodes are drawn from: all, successful or failed.
        labels: whether its actions and goals are imitated.
        weight: in a batch, relative to other demonstrations; None for as many as it has steps.
    """

    name: str
    path: Path
    count: str
    labels: bool = True
    weight: float | None = None

    @classmethod
    def of(cls, cfg: DictConfig, name: str, path: Path) -> Source:
        """The source whose options stand in `cfg.demonstrations`, in the folder `path`."""
        demos = cfg.demonstrations
        return cls(name, path, resolve_count(demos.count, demos.kind), demos.labels, demos.weight)

    def choose(self, rows: TensorDictBase) -> TensorDictBase:
        """Those of the `rows` (R) that count, as this source teaches them."""
        chosen = rows[find_counted(rows, self.count)]
        return chosen if self.labels else _without(chosen, keys.HAS_EXPERT, keys.HAS_GOAL)


def without_expert(steps: TensorDictBase) -> TensorDictBase:
    """The same steps (*), of whose states no expert has told what to do."""
    return _without(steps, keys.HAS_EXPERT)


def _without(steps: TensorDictBase, *flags: str) -> TensorDictBase:
    return steps.update({flag: torch.zeros_like(steps.get(flag)) for flag in flags})


def share_batch(own: str, fraction: float, weights: Mapping[str, float]) -> dict[str, float]:
    """Shares of a batch: `fraction` for the source of own episodes, the rest by weight."""
    total = sum(weights.values())
    return {own: fraction, **{name: (1.0 - fraction) * each / total for name, each in weights.items()}}


def list_demonstrations(cfg: DictConfig) -> dict[str, DictConfig]:
    """The configuration once for each source by name, whose options are then all of `demonstrations`."""
    demos = cfg.demonstrations
    first = {name: demos[name] for name in _OPTIONS}
    sources = _find_kinds(first) or {"expert": first}
    if not isinstance(demos.more, Mapping | None):
        raise ConfigError(f"more={demos.more}: give {{name: {{kind: ...}}}}, or null.")
    for name, given in (demos.more or {}).items():
        sources[str(name)] = _complete(str(name), given, first["steps"])
    plain: Any = OmegaConf.to_container(cfg)
    return {name: OmegaConf.create({**plain, "demonstrations": each}) for name, each in sources.items()}


def count_steps(configurations: Iterable[DictConfig]) -> int:
    """Steps that the demonstrations of all sources are asked for."""
    return sum(each.demonstrations.steps for each in configurations)


def _complete(name: str, given: Any, steps: int) -> dict[str, Any]:
    """All options of the further demonstrations `name`; `ratio` counts steps by those of the first."""
    place = f"more.{name}"
    if name in _TAKEN or not name.isidentifier():
        raise ConfigError(f"{place}: give another name, a word that is none of {', '.join(_TAKEN)}.")
    known = (*_OPTIONS, "ratio")
    if not isinstance(given, Mapping) or "kind" not in given or set(given) - set(known):
        raise ConfigError(f"{place}={given}: give kind, and what is wanted of {', '.join(known[1:])}.")
    options = {**_DEFAULTS, **given}
    ratio = options.pop("ratio", 1.0)
    check_range(f"{place}.ratio", ratio, 0.0, float("inf"), open_low=True)
    options.setdefault("steps", max(1, round(ratio * steps)))
    check_whole(f"{place}.steps", options["steps"], 1)
    return options


def _find_kinds(first: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """A source for each folder of demonstrations in the folder `path`, unless it is one itself."""
    path = None if first["path"] is None else Path(str(first["path"]))
    if path is None or (path / "card.json").exists():
        return {}
    found = {}
    for folder in sorted(each.parent for each in path.glob("*/card.json")):
        card = read_card(folder)
        kind = check_kind(card["kind"])
        if folder.name in _TAKEN[:2]:
            raise ConfigError(f"{folder}: a source of that name is filled with episodes, rename the folder.")
        steps = max(1, card[COUNTED[resolve_count(first["count"], kind)]])
        found[folder.name] = {**first, "kind": kind, "steps": steps, "path": str(folder), "policy": None}
    return found
