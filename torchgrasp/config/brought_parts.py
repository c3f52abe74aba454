"""What weights were trained with, as far as the command line does not say otherwise."""

from __future__ import annotations

from typing import Any

from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from torchgrasp.config.lenses import follow_cameras
from torchgrasp.config.overrides import given_overrides, is_plain, merge, words
from torchgrasp.errors import ConfigError

_CAMERAS = ("camera", "overhead")
# What a trained policy brings along; its transforms name the number of points.
_BROUGHT = ("model", "transforms", *_CAMERAS)
_FIXED = ("model", "num_points")
_TASK = ("horizon", "action_space")


def join_brought(cfg: DictConfig, brought: dict[str, Any], whose: str) -> DictConfig:
    """The configuration with the parts and the task that weights bring along, then what was given.

    Networks are as they were trained. Another camera may be chosen, and single values of cameras and
    transforms be changed; the transforms follow a camera's intrinsics.

    Args:
        cfg: as composed.
        brought: the configuration in the weights.
        whose: the option that names the weights, as in `policy=<file>`.
    """
    given = given_overrides()
    if refused := [each for each in given if _is_fixed(each)]:
        raise ConfigError(
            f"{whose}, which brings {', '.join((*_BROUGHT, 'num_points'))} along, does not go with "
            f"{words(refused)}: of these give another camera, or single values of camera and transforms."
        )
    chosen = {each.key_or_group for each in given} & set(_CAMERAS)
    kept = {name: cfg[name] if name in chosen else brought.get(name) for name in _BROUGHT}
    kept["transforms"] = follow_cameras(brought)["transforms"]
    task = {name: brought["env"][name] for name in _TASK if name in brought["env"]}
    plain = {name: value for name, value in cfg.items() if name not in kept}
    seen = {"num_points": brought.get("num_points", cfg.num_points)}
    joined = merge(plain, {**kept, "env": task}, seen)
    for each in given:
        _give(joined, each, whose)
    return joined


def _is_fixed(given: Override) -> bool:
    """Whether an override would make other networks, or transforms of another order."""
    part, _, inner = given.key_or_group.partition(".")
    if part == "transforms":
        # A whole transform, or an argument of one: `+transforms.points.camera=overhead`.
        return given.is_delete() or not inner or (not is_plain(given) and "." not in inner)
    return part in _FIXED or (part in _CAMERAS and given.is_delete())


def _give(joined: DictConfig, given: Override, whose: str) -> None:
    """Let a nested value of the task, a camera or a transform hold that was given."""
    name = given.key_or_group
    part, _, inner = name.partition(".")
    if not inner or part not in ("env", "transforms", *_CAMERAS) or given.is_delete():
        return
    if OmegaConf.select(joined, name.rpartition(".")[0]) is None:
        there = ", ".join(joined[part] or ("nothing",))
        raise ConfigError(f"{words([given])} finds nothing to change: {whose} brings {there} as its {part}.")
    OmegaConf.update(joined, name, given.value(), force_add=True)
