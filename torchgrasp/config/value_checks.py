"""Refuses what a configuration cannot hold: each value by its type, each part by its kind, by place."""

from __future__ import annotations

import math
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationResolutionError
from pydantic import BaseModel, ValidationError

from torchgrasp.config.part_kinds import check_parts
from torchgrasp.errors import ConfigError


def check_values(cfg: DictConfig, schema: type[BaseModel]) -> None:
    """Refuse values and parts that no recipe can work with, and what was left out, by their place.

    Args:
        cfg: a recipe's configuration.
        schema: what its values are.
    """
    # A plain copy, in which a key may be absent.
    cfg = OmegaConf.create(OmegaConf.to_container(cfg))  # pyright: ignore[reportAssignmentType]
    try:
        missing = sorted(OmegaConf.missing_keys(cfg))
        values: Any = OmegaConf.to_container(cfg, resolve=True)
    except InterpolationResolutionError as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(
            f"{error.full_key} refers to what is not there ({reason}): choose groups that go together, such "
            "as replay=images with transforms=rgbd."
        ) from error
    if missing:
        raise ConfigError(f"{', '.join(missing)} must be given, as {missing[0]}=... on the command line.")
    check_section("", values, schema)
    _refuse_infinite("", values)
    check_parts(values)


def _refuse_infinite(place: str, value: Any) -> None:
    """Refuse NaN and infinities wherever they stand, but for a planner that may take what time it needs."""
    unlimited = place.endswith(".planner.budget") and value == math.inf
    if isinstance(value, float) and not math.isfinite(value) and not unlimited:
        raise ConfigError(f"{place}={value} is no finite number: give one.")
    pairs = value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else ())
    for key, each in pairs:
        _refuse_infinite(f"{place}.{key}" if place else str(key), each)


def check_section(place: str, values: Any, section: type[BaseModel]) -> None:
    """Refuse resolved plain values that a section cannot have, by their place below `place`."""
    try:
        section.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{place}{'.' if place else ''}{_tell(error)}") from error


def _tell(error: ValidationError) -> str:
    """The first fault, with its place in front."""
    fault = error.errors()[0]
    place = ".".join(str(part) for part in fault["loc"] if not _is_branch(part))
    context: dict[str, Any] = fault.get("ctx", {})
    own = context.get("error")
    if isinstance(own, ConfigError):
        return f"{place}{own}"
    if fault["type"] == "missing":
        return f"{place} is missing from the configuration: give it, or take a configuration of conf/."
    if fault["type"] == "extra_forbidden":
        return f"{place}={fault['input']!r} is no option: leave it out."
    if fault["type"] in ("model_type", "model_attributes_type", "dict_type"):
        return f"{place}={fault['input']!r} is no section: give its options, as the configuration has them."
    if fault["type"] == "literal_error":
        return f"{place}={fault['input']!r} is unknown: give {context['expected']}."
    return f"{place}={fault['input']!r} cannot be used: {fault['msg'].lower()}."


def _is_branch(part: int | str) -> bool:
    """Whether a part of pydantic's location names a branch of a union or a validator, not a key."""
    return isinstance(part, str) and (part.startswith("function-") or part in ("float", "int", "str", "none"))
