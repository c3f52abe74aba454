"""What was given on the command line, beside what conf/ holds."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from omegaconf import DictConfig, OmegaConf

from torchgrasp.errors import ConfigError


def given_overrides() -> list[Override]:
    """What the command line says: names (`key_or_group`), values, and the words given (`input_line`)."""
    tasks = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    return OverridesParser.create().parse_overrides(list(tasks))


def given_names() -> list[str]:
    """Names of all values on the command line."""
    return [each.key_or_group for each in given_overrides()]


def is_plain(override: Override) -> bool:
    """Whether an override changes what is there, and neither adds nor deletes."""
    return override.type == OverrideType.CHANGE


def words(overrides: Iterable[Override]) -> str:
    """Overrides as they stand on the command line."""
    return ", ".join(str(each.input_line) for each in overrides)


def given_values(option: str) -> DictConfig:
    """The plain values of the command line.

    Raises:
        ConfigError: for choices of groups, additions and deletions, which do not go with `option`.
    """
    values = OmegaConf.create({})
    groups = HydraConfig.get().runtime.choices if HydraConfig.initialized() else {}
    given = given_overrides()
    refused = [each for each in given if not is_plain(each) or each.key_or_group in groups]
    if refused:
        raise ConfigError(f"{option} does not go with {words(refused)}: give other plain values alone.")
    for each in given:
        if each.key_or_group != "resume":
            OmegaConf.update(values, each.key_or_group, each.value(), force_add=True)
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
