"""Where demonstrations come from: what of the configuration decides their episodes, compared before use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from torchgrasp.config.exploration import DISTURBANCE
from torchgrasp.config.lenses import name_lenses
from torchgrasp.config.weights_files import read_trained, weights_file
from torchgrasp.data.files import describe_file
from torchgrasp.errors import ConfigError
from torchgrasp.rollouts.collection import SHARD_ROUNDS
from torchgrasp.sim.engines import describe_engine

# What demonstrations and a training run on them must have in common.
_SHARED = ("kind", "transforms", "camera", "overhead", "horizon", "action_space")

_DEFAULTS = {"overhead": None, "action_space": "ee_delta"}


def describe_provenance(cfg: DictConfig) -> dict[str, Any]:
    """All of the configuration that changes which episodes are collected."""
    plain = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(plain, dict)
    names = ("seed", "env", "engine", "objects", "camera", "overhead", "transforms", "expert")
    told: dict[str, Any] = {str(name): plain[name] for name in names if name in plain}
    demos = cfg.demonstrations
    told |= {
        "kind": demos.kind,
        "horizon": cfg.env.horizon,
        "action_space": cfg.env.action_space,
        "shard_rounds": SHARD_ROUNDS,
    }
    if demos.kind in DISTURBANCE:
        told["disturb"] = plain["collector"][DISTURBANCE[demos.kind]]
    if demos.kind == "learner":
        policy = None if demos.policy is None else weights_file(Path(str(demos.policy)))
        told["policy"] = None if policy is None else describe_file(policy)
        told["expert_start"] = plain["collector"]["expert_start"] if demos.expert_start else None
    return told


def check_same_collection(ours: dict, path: Path, card: dict) -> None:
    """Refuse to go on with a collection that another configuration began, or that was imported."""
    if "imported_from" in card["provenance"]:
        raise ConfigError(f"{path} was imported: its collection cannot go on, give another folder.")
    _refuse_differing(ours, path, card, list(ours), lambda value: value)


def check_usable(ours: dict, path: Path, card: dict) -> None:
    """Refuse to train on demonstrations that another configuration made.

    Seeds may differ, and what the card does not tell, because nothing of this project collected them, is not
    compared: rows are, when the buffer is made.
    """
    told = [name for name in _SHARED if name in card["provenance"]]
    _refuse_differing(ours, path, card, told, _unseeded)


def _refuse_differing(ours: dict, path: Path, card: dict, names: list[str], plain: Any) -> None:
    ours, theirs = (_name_engine(name_lenses(each)) for each in (ours, card["provenance"]))
    differing = [name for name in names if plain(ours.get(name)) != plain(theirs.get(name))]
    if differing:
        raise ConfigError(
            f"The demonstrations in {path} were collected with another {', '.join(differing)}: "
            f"configure that as {path / 'card.json'} tells, or give another folder."
        )


def _name_engine(told: dict) -> dict:
    """What is told, with all options of its engine."""
    engine = told.get("engine") or None
    return {**told, "engine": describe_engine(engine) if isinstance(engine, dict | None) else engine}


def check_learner(cfg: DictConfig) -> None:
    """Refuse a `demonstrations.policy` that learned from other observations than those configured."""
    policy = Path(str(cfg.demonstrations.policy))
    brought = read_trained(policy, cfg.trust).config
    if differing := find_differing(describe_provenance(cfg), {**brought, **brought.get("env", {})}):
        raise ConfigError(
            f"demonstrations.policy={policy} learned with another {', '.join(differing)}: configure it alike."
        )


def find_differing(ours: dict[str, Any], theirs: dict[str, Any]) -> list[str]:
    """What of observations, actions and horizon two configurations tell otherwise, seeds apart, by name.

    Where one leaves out the overhead camera or the action space, it has the default.
    """
    ours, theirs = (name_lenses({**_DEFAULTS, **each}) for each in (ours, theirs))
    names = [name for name in _SHARED if name in theirs and name in ours]
    return [name for name in names if _unseeded(theirs[name]) != _unseeded(ours[name])]


def _unseeded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _unseeded(each) for name, each in value.items() if name != "seed"}
    return [_unseeded(each) for each in value] if isinstance(value, list) else value
