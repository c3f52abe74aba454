"""Parts as the configuration names them; what is wrong with one is told with its place."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from torchgrasp.config.one_line_errors import find_cause
from torchgrasp.errors import ConfigError, TorchgraspError

# A library error about an argument begins with it, or with a part of it, as in `table_x[1]=0.9`.
_ARGUMENT = re.compile(r"^(\w+)(?=[=\[ ])")


def build(node: Any, *args: Any, **options: Any) -> Any:
    """What a node of the configuration describes (Hydra's `instantiate`); None for None.

    A library error names the argument, as in `alpha=2 is out of range`: its place in the configuration is
    put in front, `transforms.aggregate.alpha=2 is out of range`.
    """
    try:
        return instantiate(node, *args, **options)
    except InstantiationException as error:
        cause, (place, names) = find_cause(error), _find_place(error, node)
        if cause is not None:
            raise type(cause)(_place(str(cause), place, names)) from error
        inner = error.__cause__ or error
        reason = " ".join(str(inner).split())
        raise ConfigError(
            f"{place or 'This part'} cannot be built ({type(inner).__name__}: {reason[:300]}): check its "
            "options."
        ) from error


@contextmanager
def at_place(place: str) -> Iterator[None]:
    """Put `place` in front of the argument that a library error of the block names.

    >>> from torchgrasp.errors import check_range
    >>> with at_place("replay"):
    ...     check_range("capacity", -1, 0, 9)
    Traceback (most recent call last):
    torchgrasp.errors.ConfigError: replay.capacity=-1 is out of range: give a value in [0, 9].
    """
    try:
        yield
    except TorchgraspError as error:
        found = re.match(r"^(\w+)(?=[=\[])", str(error))
        if found is None:
            raise
        raise type(error)(f"{place}.{error}") from error


def _find_place(error: InstantiationException, node: Any) -> tuple[str, set[str]]:
    """The dotted name of the node that Hydra stopped at, and the keys that stand there."""
    told = re.search(r"full_key: ([\w.\-]+)", str(error))
    place = told[1] if told else ""
    root = node
    while isinstance(root, DictConfig) and root._get_parent() is not None:
        root = root._get_parent()
    there = OmegaConf.select(root, place) if isinstance(root, DictConfig) and place else node
    return place, set(there) if isinstance(there, DictConfig) else set()


def _place(message: str, place: str, names: set[str]) -> str:
    """`<place>.<message>` where the message begins with one of the names, else `<place>: <message>`."""
    found = _ARGUMENT.match(message)
    if not place:
        return message
    return f"{place}{'.' if found and found[1] in names else ': '}{message}"
