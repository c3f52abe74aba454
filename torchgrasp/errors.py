"""Errors that torchgrasp raises. Each message says what was given, what was expected and what to do.

A message about an argument begins with the argument's name, as in ``alpha=2 is out of range``: a recipe puts
the argument's place in the configuration before it.
"""

from __future__ import annotations

from numbers import Integral, Real


class TorchgraspError(Exception):
    """Base class: a user can mend what any of these says, so recipes print them without a traceback.

    As text, control characters of names that came from a file are escaped.
    """

    def __str__(self) -> str:
        return printable(super().__str__(), keep="\n")


class ConfigError(TorchgraspError, ValueError):
    """A value that an argument cannot take."""


class MissingPackageError(TorchgraspError, ImportError):
    """A package that is not installed, or does not load; the message says how to install it."""


class UnsupportedError(ConfigError, NotImplementedError):
    """A choice that TorchRL knows and a part of ours does not offer; TorchRL raises NotImplementedError."""


class ObjectError(TorchgraspError):
    """An object or mesh that cannot be used; the message names it."""


class CheckpointError(TorchgraspError):
    """A run directory, checkpoint or weights file that is missing, damaged or of another model."""


class DamageError(CheckpointError):
    """A file that is missing, or no longer as it was saved; only a copy, or making it again, helps."""


class StorageError(TorchgraspError):
    """A file or folder that cannot be written now: no room, no rights, or another process writes there."""


class WorkerError(TorchgraspError):
    """Workers that died again and again; what was saved before is whole."""


class PictureError(TorchgraspError):
    """A camera's picture that a policy cannot use; the next one may be better."""


class StopError(TorchgraspError):
    """An arm that has to stop, or has stopped by itself.

    Args:
        cause: in a word: ``picture``, ``late``, ``limits``, ``reflex``, ``robot`` or ``interrupted``.
        reason: in a sentence.
    """

    def __init__(self, cause: str, reason: str) -> None:
        super().__init__(reason)
        self.cause = cause


class UnstableError(TorchgraspError):
    """A world whose physics no longer tells where its bodies are; only a new one helps."""


class RenderError(TorchgraspError):
    """Rendering was asked for where it cannot work: no Vulkan device, or a forked process."""


def printable(text: object, *, keep: str = "") -> str:
    r"""The text of a value, all that would move a cursor or hide words escaped, except characters of `keep`.

    >>> print(printable("mug\x1b[31m"))
    mug\x1b[31m
    """
    return "".join(each if each.isprintable() or each in keep else _escape(each) for each in str(text))


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode()


def check_whole(name: str, value: int, low: int, high: int = 2**63 - 1) -> None:
    """Raise ConfigError unless `value` is a whole number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ConfigError(f"{name}={value} is no whole number: give digits alone, at least {low}.")
    if value < low:
        raise ConfigError(f"{name}={value} is out of range: give a whole number of at least {low}.")
    if value > high:
        raise ConfigError(f"{name}={value} is out of range: give a whole number of at most {high}.")


def check_range(name: str, value: float, low: float, high: float, *, open_low: bool = False) -> None:
    """Raise ConfigError unless ``low <= value <= high`` (``low < value`` where `open_low`)."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ConfigError(f"{name}={value!r} is no number: give one in [{low}, {high}].")
    too_low = value <= low if open_low else value < low
    if too_low or value > high or value != value:
        bracket = "(" if open_low else "["
        raise ConfigError(f"{name}={value} is out of range: give a value in {bracket}{low}, {high}].")
