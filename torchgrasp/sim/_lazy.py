"""A module that is imported when something of it is first used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class LazyModule:
    """The attributes of a module by their names.

    Args:
        load: imports the module, or says what to install.
    """

    def __init__(self, load: Callable[[], Any]) -> None:
        self._load = load

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._load(), name)
        setattr(self, name, found)
        return found
