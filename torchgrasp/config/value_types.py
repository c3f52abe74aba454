"""Types of a configuration's values, which say in one line what is wrong with one."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import torch
from pydantic import BeforeValidator

from torchgrasp.errors import ConfigError, check_range, check_whole

_DEVICES = ("cpu", "cuda", "mps", "xpu")


def _whole(low: int, high: int, value: Any) -> int:
    check_whole("", value, low, high)
    return value


def between(low: float, high: float, *, open_low: bool = False) -> BeforeValidator:
    """Of a field that is a number from `low` to `high`."""
    return checked(partial(_number, low, high, open_low=open_low))


def _number(low: float, high: float, value: Any, *, open_low: bool = False) -> float:
    check_range("", value, low, high, open_low=open_low)
    return value


def _switch(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ConfigError(f"={value} is no switch: give true or false.")
    return value


def _switch_or_auto(value: Any) -> bool | str:
    return value if value == "auto" else _switch(value)


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
    return value if value == "auto" else _whole(0, _MANY, value)


def _seeds(value: Any) -> list[int]:
    return [_whole(0, _LARGEST_SEED, each) for each in (value if isinstance(value, list) else [value])]


def _device(value: Any) -> str:
    try:
        if torch.device(value).type not in _DEVICES:
            raise RuntimeError(f"known are {', '.join(_DEVICES)}")
        torch.empty(0, device=value)
    except (RuntimeError, AssertionError, TypeError) as error:
        raise ConfigError(f"={value} cannot be used ({str(error).splitlines()[0]}): give cpu.") from error
    return value


def _path(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float) or str(value) in ("", "\0"):
        raise ConfigError(f"={value} is no path: give that of a folder or file.")
    return str(value)


def _packages(value: Any) -> list[str]:
    if not isinstance(value, list):
        raise ConfigError(f"={value} is no list: give names of packages, as [{value}].")
    for name in value:
        if not (isinstance(name, str) and name.isidentifier() and importlib.util.find_spec(name)):
            raise ConfigError(
                f"={value}: {name} is no installed package, give the first word of its imports."
            )
    return value


def checked(check: Callable) -> BeforeValidator:
    """Of a field whose values `check` returns, or refuses by a ConfigError."""
    return BeforeValidator(check)


# Beyond what any run counts to; numbers of that size come from slips of the pen and damaged files.
_MANY = 10**12
_LARGEST_SEED = 2**32 - 1  # NumPy's


def at_least(low: int, high: int = _MANY) -> BeforeValidator:
    """Of a field that is a whole number from `low` to `high`."""
    return checked(partial(_whole, low, high))


Seed = Annotated[int, at_least(0, _LARGEST_SEED)]
Count = Annotated[int, at_least(0)]
Positive = Annotated[int, at_least(1)]
Points = Annotated[int, at_least(1, 1_000_000)]
Rows = Annotated[int, at_least(1, 10_000_000)]
Worlds = Annotated[int, at_least(1, 10_000)]
Workers = Annotated[int, at_least(0, 10_000)]
Horizon = Annotated[int, at_least(1, 100_000)]
Share = Annotated[float, between(0.0, 1.0)]
NotNegative = Annotated[float, between(0.0, float("inf"))]
# A factor of 0 would end learning at the first milestone without a word.
Factor = Annotated[float, between(0.0, 1.0, open_low=True)]
Switch = Annotated[bool, checked(_switch)]
SwitchOrAuto = Annotated[bool | str, checked(_switch_or_auto)]
Shares = Annotated[list[float], checked(_shares)]
Device = Annotated[str, checked(_device)]
FilePath = Annotated[str, checked(_path)]
Packages = Annotated[list[str], checked(_packages)]
Updates = Annotated[int | str, checked(_updates)]
Seeds = Annotated[list[int], checked(_seeds)]
