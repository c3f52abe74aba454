"""The plain values of every recipe's configuration, typed; nodes with a `_target_` check themselves.

Keys that a section here does not name are left to Hydra, which refuses those that no file of conf/ has.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal, TypeVar

import torch
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationResolutionError
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from torchgrasp.errors import ConfigError, check_range, check_whole

_Value = TypeVar("_Value")


def _whole(low: int, value: Any) -> int:
    check_whole("", value, low)
    return value


def _number(low: float, high: float, value: Any, *, open_low: bool = False) -> float:
    check_range("", value, low, high, open_low=open_low)
    return value


def _switch(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ConfigError(f"={value} is no switch: give true or false.")
    return value


def _shares(value: Any) -> list[float]:
    shares: list[Any] = list(value) if isinstance(value, list | tuple) else [None]
    numbers = [each for each in shares if type(each) in (int, float) and 0.0 <= each <= 1.0]
    if len(numbers) < len(shares) or numbers != sorted(set(numbers)):
        raise ConfigError(
            f"={value}: give shares of the run from 0 to 1, each once and in order, such as [0.4, 0.7], or "
            "[] for a rate that stays."
        )
    return numbers


def _updates(value: Any) -> int | str:
    return value if value == "auto" else _whole(0, value)


def _device(value: str) -> str:
    try:
        torch.empty(0, device=value)
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"={value} cannot be used ({str(error).splitlines()[0]}): give cpu.") from error
    return value


def _at(check: Callable) -> BeforeValidator:
    return BeforeValidator(check)


def at_least(low: int) -> BeforeValidator:
    """Of a field that is a whole number, and no smaller than `low`."""
    return _at(partial(_whole, low))


Count = Annotated[int, at_least(0)]
Positive = Annotated[int, at_least(1)]
Share = Annotated[float, _at(partial(_number, 0.0, 1.0))]
NotNegative = Annotated[float, _at(partial(_number, 0.0, float("inf")))]
# A factor of 0 would end learning at the first milestone without a word.
Factor = Annotated[float, _at(partial(_number, 0.0, 1.0, open_low=True))]
Switch = Annotated[bool, _at(_switch)]
Shares = Annotated[list[float], _at(_shares)]
Device = Annotated[str, AfterValidator(_device)]


class Section(BaseModel):
    """Some of the values of a section; the others are let through."""

    model_config = ConfigDict(extra="allow", frozen=True)


class Env(Section):
    """conf/env."""

    num_envs: Positive = 1
    horizon: Positive = 30


class Demonstrations(Section):
    """A source of demonstrations: D_expert, or one of `demonstrations.more` with all of its options."""

    steps: Positive
    labels: Switch = True
    expert_start: Switch = False
    weight: NotNegative | None = None


class Pretrain(Section):
    """Imitation before the main phase."""

    steps: Count
    batch_size: Positive
    aux_weight: NotNegative
    critic: Switch
    learning_rate: NotNegative


class Online(Section):
    """The main phase."""

    updates: Positive
    policy_delay: Positive
    critic_warmup: Count
    learning_rate: NotNegative
    milestones: Shares
    decay: Factor
    gamma: Share
    tau: Share
    period: Positive
    dagger: Switch = True
    self_imitation: Switch = False


class Offline(Section):
    """Updates on demonstrations alone."""

    updates: Annotated[int | str, _at(_updates)]


class Replay(Section):
    """conf/replay."""

    batch_size: Positive
    online_fraction: Share
    online_capacity: Positive


class Collector(Section):
    """conf/collector and conf/exploration."""

    num_workers: Count
    episodes: Positive = 14
    overlap: Switch = False


class Evaluation(Section):
    """The scenes that a policy is scored on."""

    num_envs: Positive
    num_objects: Positive | None
    seed: Count = 0
    episodes: Positive = 1
    baselines: list[Literal["expert", "random"]] = []
    grasp_prediction: Switch = False


class Checkpoint(Section):
    """How often a run is saved."""

    iterations: Positive
    steps: Positive


class Network(Section):
    """Actor, critic or goal network; those without a switch leave it at false."""

    goal_input: Switch = False
    goal_prediction: Switch = False
    freeze_encoder: Switch = False


class Model(Section):
    """conf/model."""

    table_input: Switch = False
    actor: Network
    critic: Network


class Video(Section):
    """Films of an evaluation."""

    episodes: Count
    fps: Annotated[float, _at(partial(_number, 1, 1000))]


class Training(Section):
    """td3_bc.py, bc.py, hindsight.py and collect.py."""

    seed: Count
    num_points: Positive
    device: Device
    total_env_steps: Count
    env: Env
    offline: Offline
    demonstrations: Demonstrations
    pretrain: Pretrain
    online: Online
    replay: Replay
    collector: Collector
    evaluation: Evaluation
    checkpoint: Checkpoint
    model: Model


class Evaluate(Section):
    """evaluate.py and view.py."""

    seed: Count
    episodes: Positive
    num_points: Positive
    env: Env
    collector: Collector
    evaluation: Evaluation
    grasp_prediction: Switch
    video: Video


class Pendulum(Section):
    """pendulum.py."""

    num_envs: Positive
    horizon: Positive
    random_steps: Positive
    online_steps: Positive
    online_fraction: Share
    updates: Count
    policy_delay: Positive
    batch_size: Positive
    hidden: Positive
    learning_rate: NotNegative
    milestones: Shares
    decay: Factor
    gamma: Share
    tau: Share
    period: Positive
    evaluation_episodes: Positive


def check_values(cfg: DictConfig, schema: type[Section] | None = None) -> None:
    """Refuse values that no recipe can work with, and what was left out, by their place.

    Args:
        cfg: a recipe's configuration.
        schema: what its values are; None looks for what was left out alone.
    """
    # A plain copy, in which a key may be absent.
    cfg = OmegaConf.create(OmegaConf.to_container(cfg))  # pyright: ignore[reportAssignmentType]
    try:
        missing = sorted(OmegaConf.missing_keys(cfg))
        values = OmegaConf.to_container(cfg, resolve=True)
    except InterpolationResolutionError as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(
            f"{error.full_key} refers to what is not there ({reason}): choose groups that go together, such "
            "as replay=images with transforms=rgbd."
        ) from error
    if missing:
        raise ConfigError(f"{', '.join(missing)} must be given, as {missing[0]}=... on the command line.")
    if schema is not None:
        _validate("", values, schema)


def check_section(place: str, values: DictConfig, section: type[Section]) -> None:
    """Refuse values that a section cannot have, by their place below `place`."""
    _validate(f"{place}.", OmegaConf.to_container(values, resolve=True), section)


def _validate(place: str, values: Any, section: type[Section]) -> None:
    try:
        section.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{place}{_tell(error)}") from error


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
    if fault["type"] == "literal_error":
        return f"{place}={fault['input']!r} is unknown: give {context['expected']}."
    return f"{place}={fault['input']!r} cannot be used: {fault['msg'].lower()}."


def _is_branch(part: int | str) -> bool:
    """Whether a part of pydantic's location names a branch of a union or a validator, not a key."""
    return isinstance(part, str) and (part.startswith("function-") or part in ("float", "int", "str", "none"))
