"""The configuration of an evaluation: what a trained policy brings along, then what was given."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from torchgrasp.config.brought_parts import join_brought
from torchgrasp.config.overrides import copy, given_names, merge
from torchgrasp.config.policies import POLICIES, RELAYS
from torchgrasp.config.schema import Evaluate
from torchgrasp.config.value_checks import check_values
from torchgrasp.config.weights_files import check_weights, read_trained
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.protocols import find_protocol

# The tabletop protocol's fixed start, unless start=varied says otherwise.
_TABLETOP = {"_target_": "torchgrasp.envs.TabletopStart", "spread": 0.0}


def evaluation_config(cfg: DictConfig) -> DictConfig:
    """The checked configuration of recipes/evaluate.py with its protocol and its policy's own parts."""
    cfg = _follow_protocol(copy(cfg))
    check_values(cfg, Evaluate)
    option, path = _find_learned(cfg)
    if path is None and "model" in cfg:
        raise ConfigError(f"model={cfg.model} does not go with policy={cfg.policy}: leave it out.")
    if path is not None:
        brought = read_trained(path, cfg.trust).config
        cfg = join_brought(cfg, brought, f"{option}={path}")
    # objects.split=... and objects.num_objects=... say which objects, as everywhere.
    chosen = {
        name: cfg.objects[name] for name in ("split", "num_objects") if f"objects.{name}" in given_names()
    }
    own = {"episodes": cfg.episodes, "seed": cfg.seed}
    return merge(cfg, {"evaluation": {**own, **chosen}})


def _follow_protocol(cfg: DictConfig) -> DictConfig:
    """The configuration with what its protocol changes, where nothing else was given."""
    protocol, given = find_protocol(cfg.protocol), given_names()
    if protocol.target_motion is not None and "env.target_motion" not in given:
        cfg.env.target_motion = protocol.target_motion
    if protocol.tabletop and cfg.env.start._target_ != _TABLETOP["_target_"]:
        if any(name.startswith("env.start") for name in given):
            raise ConfigError("protocol=tabletop has a start of its own: add start=fixed or start=varied.")
        cfg.env.start = _TABLETOP
    return cfg


def _find_learned(cfg: DictConfig) -> tuple[str, Path | None]:
    """The option that names what is trained, and its run directory or weights file; None without any."""
    policy, learner = str(cfg.policy), cfg.learner
    if policy in RELAYS:
        if learner is None:
            raise ConfigError(
                f"policy={policy} needs a learner: add learner=<run dir or weights file>, or random."
            )
        option, name, named = "learner", str(learner), ("random",)
    elif learner is not None:
        raise ConfigError(f"learner={learner} does not go with policy={policy}: give {' or '.join(RELAYS)}.")
    else:
        option, name, named = "policy", policy, POLICIES
    if name in named:
        return option, None
    check_weights(option, name, *named)
    return option, Path(name)
