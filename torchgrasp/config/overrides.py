"""What was given on the command line, beside what conf/ holds."""

from __future__ import annotations

from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from torchgrasp.errors import ConfigError


def given_names() -> list[str]:
    """Names of all values on the command line."""
    tasks = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    return [each.lstrip("+~").split("=")[0] for each in tasks]


def given_values(option: str, *, fixed: tuple[str, ...] = ()) -> DictConfig:
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


def merge(*parts: Any) -> DictConfig:
    """Configurations joined, later ones first; a plain copy in which keys may be added."""
    merged: Any = OmegaConf.merge(*parts)
    return merged


def copy(cfg: DictConfig) -> DictConfig:
    """A plain copy, in which keys may be added and removed."""
    return merge(OmegaConf.to_container(cfg))


def plain(node: Any) -> Any:
    """A node of a configuration as dicts, lists and plain values; a plain value itself."""
    return OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node
