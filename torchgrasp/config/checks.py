"""Configurations: checked before anything is written, taken up by resume, brought along by weights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import sweeps
import torch
import yaml
from behaviour import check_behaviour, check_demonstrators
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from schedule import check_schedule
from sources import list_demonstrations

from torchgrasp.data import count_shards
from torchgrasp.data.demonstration_kinds import check_kind, resolve_count
from torchgrasp.data.files import find_folder
from torchgrasp.errors import CheckpointError, ConfigError, check_range, check_whole
from torchgrasp.runs.run_directory import make_run_dir
from torchgrasp.runs.weights import PRETRAINED, load_weights

# config.yaml is resolved, for readers; this one keeps its references, so that a change reaches all.
_UNRESOLVED = ".config_unresolved.yaml"
# What recipes/evaluate.py's protocols change in the environment (Sec. 6.6 and 6.7).
_PROTOCOLS = {
    "static": {},
    "moving": {"target_motion": "jitter"},
    "tabletop": {},
    "handover": {"target_motion": "handover"},
}
# What recipes/evaluate.py evaluates besides trained policies; the last two need a learner.
POLICIES = ("expert", "random", "planning", "combined", "takeover")
_RELAYS = ("combined", "takeover")
# The tabletop protocol's fixed start, unless start=varied says otherwise.
_TABLETOP = {"_target_": "torchgrasp.envs.TabletopStart", "spread": 0.0}
# Whole numbers and the least that each can be.
_AT_LEAST = {
    "seed": 0, "total_env_steps": 0, "demonstrations.steps": 1, "pretrain.steps": 0,
    "pretrain.batch_size": 1, "replay.batch_size": 1, "replay.online_capacity": 1, "collector.episodes": 1,
    "online.updates": 1, "online.policy_delay": 1, "online.critic_warmup": 0, "evaluation.episodes": 1,
    "evaluation.num_envs": 1, "evaluation.seed": 0, "checkpoint.iterations": 1, "checkpoint.steps": 1,
    "episodes": 1, "resets": 10, "batch": 1, "scenes": 1, "video.episodes": 0, "collector.num_workers": 0,
    "env.num_envs": 1, "env.horizon": 1, "num_points": 1, "clouds.batch": 1, "clouds.points": 1,
    "clouds.repeats": 1, "clouds.threads": 1, "draws": 1, "training.iterations": 1, "training.warmup": 0,
}  # fmt: skip
_SWITCHES = (
    *("demonstrations.expert_start", "pretrain.critic", "logger.tensorboard", "grasp_prediction"),
    *("evaluation.grasp_prediction", "online.dagger", "online.self_imitation", "collector.overlap"),
    "model.table_input",
    *(
        f"model.{network}.{name}"
        for network in ("actor", "critic")
        for name in ("goal_input", "goal_prediction", "freeze_encoder")
    ),
)


def check_values(cfg: DictConfig) -> None:
    """Refuse numbers that no recipe can work with, and what was left out."""
    cfg = _merge(OmegaConf.to_container(cfg))  # a plain copy, in which a key may be absent
    missing = sorted(OmegaConf.missing_keys(cfg))
    if missing:
        raise ConfigError(f"{', '.join(missing)} must be given, as {missing[0]}=... on the command line.")
    for name, low in _AT_LEAST.items():
        value = OmegaConf.select(cfg, name, default=low)
        check_whole(name, value, low)
    check_schedule(cfg)
    check_range("video.fps", OmegaConf.select(cfg, "video.fps", default=1), 1, 1000)
    for name in _SWITCHES:
        value = OmegaConf.select(cfg, name, default=False)
        if not isinstance(value, bool):
            raise ConfigError(f"{name}={value} is no switch: give true or false.")
    for name in OmegaConf.select(cfg, "evaluation.baselines") or ():
        if name not in ("expert", "random"):
            raise ConfigError(f"evaluation.baselines names {name!r}: choose from expert and random.")
    check_device(str(OmegaConf.select(cfg, "device", default="cpu")))
    if "demonstrations" in cfg:
        for each in list_demonstrations(cfg).values():
            _check_demonstrations(each.demonstrations)
            check_demonstrators(each)
        if cfg.init is not None and not has_checkpoint(cfg.resume):
            _check_weights("init", str(cfg.init))


def check_device(name: str) -> None:
    """Refuse a device that torch does not find."""
    try:
        torch.empty(0, device=name)
    except (RuntimeError, AssertionError) as error:
        message = str(error).splitlines()[0]
        raise ConfigError(f"device={name} cannot be used ({message}): give cpu.") from error


def _check_demonstrations(demonstrations: DictConfig) -> None:
    kind, policy = demonstrations.kind, demonstrations.policy
    resolve_count(demonstrations.count, check_kind(kind))
    if not isinstance(demonstrations.labels, bool):
        raise ConfigError(f"demonstrations.labels={demonstrations.labels} is no switch: give true or false.")
    if demonstrations.weight is not None:
        check_range("demonstrations.weight", demonstrations.weight, 0.0, float("inf"))
    given = demonstrations.path is not None and count_shards(demonstrations.path) > 0
    if (kind == "learner") != (policy is not None) and not (given and policy is None):
        raise ConfigError(
            f"demonstrations.kind={kind} with demonstrations.policy={policy}: the kind learner needs a "
            "policy, a run directory or weights file; no other kind takes one."
        )
    if policy is not None:
        _check_weights("demonstrations.policy", str(policy))


def _check_weights(option: str, name: str, *others: str) -> None:
    """Refuse what names no weights; `others` are names that the option takes besides."""
    path = Path(name)
    if path.is_dir() and not weights_file(path).is_file():
        raise ConfigError(
            f"{option}={name!r} holds no weights.safetensors: give the run directory of a training that has "
            "saved its first checkpoint."
        )
    if not weights_file(path).is_file():
        choices = ", ".join((*others, "pretrained", "a run directory"))
        raise ConfigError(f"{option}={name!r} is not there: give {choices} or a weights file.")


def resumed(cfg: DictConfig, recipe: str) -> DictConfig:
    """The configuration itself, or with `resume` that of the run resumed, changed by what was given."""
    if cfg.recipe != recipe:
        raise ConfigError(f"This experiment is for recipes/{cfg.recipe}.py: run it by that, not {recipe}.py.")
    if cfg.resume is not None:
        stored = _read(Path(cfg.resume) / _UNRESOLVED, f"resume={cfg.resume}", recipe)
        cfg = _merge(stored, _given_values(f"resume={cfg.resume}"), {"resume": cfg.resume})
    check_values(cfg)
    check_behaviour(cfg, "noise", f"recipes/{recipe}.py")
    return cfg


def has_checkpoint(run: str | Path | None) -> bool:
    """Whether there is a run directory and a checkpoint in it, whole or damaged: it does not begin anew."""
    return run is not None and find_folder(Path(run) / "checkpoint").exists()


def open_run(cfg: DictConfig, recipe: str) -> Path:
    """The directory of the run that `resume` names, or a new one with the configuration in it."""
    if cfg.get("resume") is not None:
        sweeps.note(Path(cfg.resume))
        return Path(cfg.resume)
    run_dir = make_run_dir(recipe, root=cfg.output_dir)
    sweeps.note(run_dir)
    OmegaConf.save(cfg, run_dir / "config.yaml", resolve=True)
    OmegaConf.save(cfg, run_dir / _UNRESOLVED)
    return run_dir


def for_evaluation(cfg: DictConfig) -> DictConfig:
    """The configuration of recipes/evaluate.py: what a trained policy brings along, then what was given."""
    cfg = _merge(OmegaConf.to_container(cfg))
    if cfg.protocol not in _PROTOCOLS:
        raise ConfigError(f"protocol={cfg.protocol!r} is unknown: give one of {', '.join(_PROTOCOLS)}.")
    given = given_names()
    changes = {name: value for name, value in _PROTOCOLS[cfg.protocol].items() if f"env.{name}" not in given}
    cfg = _merge(cfg, {"env": changes})
    if cfg.protocol == "tabletop" and cfg.env.start._target_ != _TABLETOP["_target_"]:
        if any(name.startswith("env.start") for name in given):
            raise ConfigError("protocol=tabletop has a start of its own: add start=fixed or start=varied.")
        cfg.env.start = _TABLETOP
    check_values(cfg)
    option, path = _learned(cfg)
    if path is not None:
        brought = brought_along(path, list(cfg.trust))
        kept = {name: brought.get(name) for name in ("model", "camera", "overhead", "transforms")}
        fixed = (*kept, "num_points")  # which its transforms name
        given = _given_values(f"{option}={path}, which brings {', '.join(fixed)} along,", fixed=fixed)
        task = {name: brought["env"][name] for name in ("horizon", "action_space") if name in brought["env"]}
        plain = {key: value for key, value in cfg.items() if key not in kept}
        seen = {"num_points": brought.get("num_points", cfg.num_points)}
        cfg = _merge(plain, {**kept, "env": task}, given, seen)
    # objects.split=... and objects.num_objects=... say which objects, as everywhere.
    chosen = {
        name: cfg.objects[name] for name in ("split", "num_objects") if f"objects.{name}" in given_names()
    }
    own = {"episodes": cfg.episodes, "seed": cfg.seed}
    return _merge(cfg, {"evaluation": {**own, **chosen}})


def _learned(cfg: DictConfig) -> tuple[str, Path | None]:
    """The option that names what is trained, and its run directory or weights file; None without any."""
    policy, learner = str(cfg.policy), cfg.learner
    if policy in _RELAYS:
        if learner is None:
            raise ConfigError(
                f"policy={policy} needs a learner: add learner=<run dir or weights file>, or random."
            )
        option, name, named = "learner", str(learner), ("random",)
    elif learner is not None:
        raise ConfigError(f"learner={learner} does not go with policy={policy}: give {' or '.join(_RELAYS)}.")
    else:
        option, name, named = "policy", policy, POLICIES
    if name in named:
        return option, None
    _check_weights(option, name, *named)
    return option, Path(name)


def given_names() -> list[str]:
    """Names of all values on the command line."""
    tasks = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    return [each.lstrip("+~").split("=")[0] for each in tasks]


def expand_video(arguments: list[str]) -> list[str]:
    """A command line in which `video=true` and `video=false` are numbers of episodes, as Hydra wants it."""
    switch = {"video=true": "video.episodes=3", "video=false": "video.episodes=0"}
    numbered = any(each.startswith("video.episodes=") for each in arguments)
    expanded = [switch.get(each.lower(), each) for each in arguments]
    return [e for e, a in zip(expanded, arguments, strict=True) if not (numbered and e != a)]


def weights_file(path: Path) -> Path:
    """The weights of a run directory, the file itself, or what comes with the library as `pretrained`."""
    if str(path) == "pretrained":
        return PRETRAINED
    return path / "weights.safetensors" if path.is_dir() else path


def brought_along(policy: Path, trusted: list[str]) -> dict[str, Any]:
    """The configuration in a policy's weights, whose classes are of torchgrasp, torchrl or `trusted`."""
    brought = load_weights(weights_file(policy))[1]
    _check_targets(brought, trusted)
    return brought


def _merge(*parts: Any) -> DictConfig:
    merged: Any = OmegaConf.merge(*parts)
    return merged


def _read(file: Path, option: str, recipe: str) -> DictConfig:
    if not file.is_file():
        raise CheckpointError(f"{option} is no run directory of {recipe} ({file.name} is not in it).")
    try:
        stored: Any = OmegaConf.load(file)
    except (yaml.YAMLError, OmegaConfBaseException, OSError) as error:
        raise CheckpointError(f"{file} cannot be read ({error}): restore it from a copy.") from error
    kind = stored.get("recipe") if isinstance(stored, DictConfig) else None
    if kind != recipe:
        raise CheckpointError(
            f"{option} is no run directory of {recipe}: {file} is of {kind or 'another kind'}."
        )
    return stored


def _given_values(option: str, *, fixed: tuple[str, ...] = ()) -> DictConfig:
    """The plain values of the command line, nested ones alone where some parts of the whole are `fixed`.

    Choices of groups, additions and deletions do not go with `option`, nor do values of fixed parts.
    """
    if not HydraConfig.initialized():
        return OmegaConf.create({})
    hydra = HydraConfig.get()
    given = {each: each.split("=")[0] for each in hydra.overrides.task}
    groups = set(fixed) if fixed else set(hydra.runtime.choices)
    refused = [each for each, name in given.items() if each[0] in "~+" or name in groups]
    refused += [each for each, name in given.items() if "." in name and name.split(".")[0] in fixed]
    if refused:
        raise ConfigError(f"{option} does not go with {', '.join(refused)}: give other plain values alone.")
    plain = [each for each, name in given.items() if name != "resume" and ("." in name or not fixed)]
    values = OmegaConf.create({})
    for override in OverridesParser.create().parse_overrides(plain):
        OmegaConf.update(values, override.key_or_group, override.value(), force_add=True)
    return values


def _check_targets(config: Any, trusted: list[str]) -> None:
    """Refuse classes of packages that a weights file names and nobody vouches for."""
    allowed = ("torchgrasp", "torchrl", *trusted)
    if isinstance(config, dict):
        target = config.get("_target_")
        if target is not None and str(target).split(".")[0] not in allowed:
            raise ConfigError(
                f"The weights name the class {target}, which could run anything: if you know where they come "
                f"from, add trust=[{str(target).split('.')[0]}]."
            )
        config = list(config.values())
    for each in config if isinstance(config, list) else ():
        _check_targets(each, trusted)
