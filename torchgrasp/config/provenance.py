"""Where demonstrations come from: what of the configuration decides their episodes, compared before use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import settings
from behaviour import DISTURBANCE
from omegaconf import DictConfig, OmegaConf
from sources import Source
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.data import Demonstrations, begin_demonstrations, count_shards, open_demonstrations
from torchgrasp.data.demonstration_kinds import COUNTED, resolve_count
from torchgrasp.data.files import describe_file
from torchgrasp.errors import ConfigError

# Rounds of all worlds in a shard, which is written whole or not at all.
SHARD_ROUNDS = 4
# What demonstrations and a training run on them must have in common.
SHARED = ("kind", "transforms", "camera", "overhead", "horizon", "action_space")


def describe_origin(cfg: DictConfig) -> dict[str, Any]:
    """All of the configuration that changes which episodes are collected."""
    plain = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(plain, dict)
    names = ("seed", "env", "objects", "camera", "overhead", "transforms", "expert")
    origin: dict[str, Any] = {str(name): plain[name] for name in names if name in plain}
    demos = cfg.demonstrations
    origin |= {
        "kind": demos.kind,
        "horizon": cfg.env.horizon,
        "action_space": cfg.env.action_space,
        "shard_rounds": SHARD_ROUNDS,
    }
    if demos.kind in DISTURBANCE:
        origin["disturb"] = plain["collector"][DISTURBANCE[demos.kind]]
    if demos.kind == "learner":
        policy = None if demos.policy is None else settings.weights_file(Path(str(demos.policy)))
        origin["policy"] = None if policy is None else describe_file(policy)
        origin["expert_start"] = plain["collector"]["expert_start"] if demos.expert_start else None
    return origin


def check_origin(ours: dict, path: Path, card: dict, names: tuple[str, ...] = ()) -> None:
    """Refuse demonstrations that another configuration made; `names` tells what must agree, () for all.

    Of what is shared with a training run, seeds may differ, and what the card does not tell, because
    nothing of this project collected them, is not compared: see `check_rows`.
    """
    theirs = card["provenance"]
    if not names and "imported_from" in theirs:
        raise ConfigError(f"{path} was imported: its collection cannot go on, give another folder.")
    plain = _unseeded if names else (lambda value: value)
    told = [name for name in names if name in theirs] if names else ours
    differing = [name for name in told if plain(ours.get(name)) != plain(theirs.get(name))]
    if differing:
        raise ConfigError(
            f"The demonstrations in {path} were collected with another {', '.join(differing)}: "
            f"configure that as {path / 'card.json'} tells, or give another folder."
        )


def take_given(cfg: DictConfig, name: str) -> Source:
    """The source `name` in the folder `demonstrations.path`, which fits the configuration.

    Only further demonstrations may lack a path here, where nothing is collected.
    """
    if cfg.demonstrations.path is None:
        raise ConfigError(
            f"demonstrations.more.{name} has no path, and recipes/{cfg.recipe}.py collects nothing: collect "
            f"it by recipes/collect.py first, and give {name} that folder as its path."
        )
    path = Path(str(cfg.demonstrations.path))
    if not count_shards(path):
        raise ConfigError(
            f"demonstrations.path={path} holds none: collect them by recipes/collect.py first, or give the "
            "folder that they were moved to."
        )
    card = begin_demonstrations(path, kind=cfg.demonstrations.kind)
    check_origin(describe_origin(cfg), path, card, SHARED)
    check_enough(cfg, path)
    return Source.of(cfg, name, path)


def check_rows(opened: Demonstrations, row: TensorDictBase) -> None:
    """Refuse demonstrations whose rows have not the shapes of `row`, one that the learner would store."""
    # Which source they are is told when they are added.
    expected = {name: tuple(value.shape[1:]) for name, value in row.items() if name != keys.SOURCE}
    for rows in opened.iterate_rows():
        for name, shape in expected.items():
            value = rows.get(name, None)
            found = None if value is None else tuple(value.shape[1:])
            if found != shape:
                raise ConfigError(
                    f"The demonstrations in {opened.path} hold {name!r} of shape {found}, the configuration "
                    f"wants {shape}: configure transforms and model as they were made, or give others."
                )


def check_enough(cfg: DictConfig, path: Path) -> None:
    """Say it where fewer steps count than were asked for; refuse demonstrations of which none counts."""
    demos, card = cfg.demonstrations, open_demonstrations(path, verify=False).card
    count = resolve_count(demos.count, demos.kind)
    have = card[COUNTED[count]]
    if not have:
        raise ConfigError(
            f"Of {card['steps']} steps in {path}, none are of {count} episodes: give another "
            "demonstrations.count, or other demonstrations."
        )
    if have < demos.steps:
        print(
            f"{path} holds {have} steps that count ({count} episodes), demonstrations.steps={demos.steps} "
            "asks for more: training goes on with them. If they are being collected, stop, and finish that "
            f"by recipes/collect.py with the same options first; else give demonstrations.steps={have}."
        )


def check_learner(cfg: DictConfig) -> None:
    """Refuse a `demonstrations.policy` that learned from other observations than those configured."""
    policy = Path(str(cfg.demonstrations.policy))
    brought = settings.brought_along(policy, list(cfg.trust))
    ours, theirs = describe_origin(cfg), {**brought, **brought.get("env", {})}
    names = [name for name in SHARED if name in theirs]
    differing = [name for name in names if _unseeded(theirs[name]) != _unseeded(ours[name])]
    if differing:
        raise ConfigError(
            f"demonstrations.policy={policy} learned with another {', '.join(differing)}: configure it alike."
        )


def _unseeded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _unseeded(each) for name, each in value.items() if name != "seed"}
    return [_unseeded(each) for each in value] if isinstance(value, list) else value
