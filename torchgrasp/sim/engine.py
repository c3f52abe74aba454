"""What an engine is: it builds worlds, whose bodies then move by its own physics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from torchgrasp.sim.world import Placement, World


class Engine(ABC):
    """A physics, with its own options; worlds of one are told from those of another by nothing else.

    Attributes:
        name: by which it is chosen.
    """

    name: ClassVar[str]

    @abstractmethod
    def build(self, placement: Placement) -> World:
        """A world in which an episode begins as `placement` says, the arm at rest."""

    @abstractmethod
    def check(self) -> None:
        """Raise MissingPackageError where what the engine needs is not installed."""
