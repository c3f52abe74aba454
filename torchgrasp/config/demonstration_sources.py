"""Demonstrations as the configuration names them: D_expert, and what stands beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from torchgrasp.config.schema import Demonstrations
from torchgrasp.data.demonstration_card import read_card
from torchgrasp.data.demonstration_kinds import COUNTED, check_kind, resolve_count
from torchgrasp.data.demonstration_sources import DemonstrationSource
from torchgrasp.errors import ConfigError, check_range, check_whole

# Sources that episodes go to, or D_expert: names that further demonstrations cannot have.
_TAKEN = ("online", "hindsight", "expert")
_FIELDS = {name: field for name, field in Demonstrations.model_fields.items() if name != "more"}
_DEFAULTS = {name: field.default for name, field in _FIELDS.items() if not field.is_required()}
_OPTIONS = tuple(_FIELDS)


def make_source(cfg: DictConfig, name: str, path: Path) -> DemonstrationSource:
    """The source whose options stand in `cfg.demonstrations`, in the folder `path`."""
    demos = cfg.demonstrations
    count = resolve_count(demos.count, demos.kind)
    return DemonstrationSource(name, path, count, labels=demos.labels, weight=demos.weight)


def list_demonstrations(cfg: DictConfig) -> dict[str, DictConfig]:
    """The configuration once for each source by name, whose options are then all of `demonstrations`."""
    demos = cfg.demonstrations
    first = {name: demos[name] for name in _OPTIONS}
    sources = _find_kinds(first) or {"expert": first}
    if not isinstance(demos.more, Mapping | None):
        raise ConfigError(f"demonstrations.more={demos.more}: give {{name: {{kind: ...}}}}, or null.")
    for name, given in (demos.more or {}).items():
        sources[str(name)] = _complete(str(name), given, first["steps"])
    plain: Any = OmegaConf.to_container(cfg)
    return {name: OmegaConf.create({**plain, "demonstrations": each}) for name, each in sources.items()}


def list_read(cfg: DictConfig) -> dict[str, DictConfig]:
    """Those of `list_demonstrations` that a run learns from: none where it draws own episodes alone."""
    return {} if learns_alone(cfg) else list_demonstrations(cfg)


def learns_alone(cfg: DictConfig) -> bool:
    """Whether a run learns from its own episodes alone; hindsight.py has no imitation."""
    taught = cfg.recipe != "hindsight" and cfg.pretrain.steps
    return not taught and draws_own_alone(cfg)


def draws_own_alone(cfg: DictConfig) -> bool:
    """Whether the main phase draws its own episodes alone."""
    return not cfg.offline.updates and cfg.replay.online_fraction == 1.0


def count_steps(configurations: Iterable[DictConfig]) -> int:
    """Steps that the demonstrations of all sources are asked for."""
    return sum(each.demonstrations.steps for each in configurations)


def _complete(name: str, given: Any, steps: int) -> dict[str, Any]:
    """All options of the further demonstrations `name`; `ratio` counts steps by those of the first."""
    place = f"demonstrations.more.{name}"
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
