"""MuJoCo as an engine, and the numbers of its contact model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.sim.engine import Engine
from torchgrasp.sim.mujoco._mujoco import load_mujoco
from torchgrasp.sim.mujoco.mujoco_world import MujocoWorld
from torchgrasp.sim.mujoco.scene_model import Contact
from torchgrasp.sim.world import Placement, World


@dataclass(frozen=True)
class MujocoEngine(Engine):
    """MuJoCo with elliptic friction cones, Newton's solver and the integrator ``implicitfast``.

    Friction, masses, forces and rates are those of `Physics`; here is what MuJoCo needs besides.

    Attributes:
        substeps: MuJoCo's steps in each of Physics's (`free_rate`, `close_rate`, ...).
        softness: seconds in which a contact gives way and comes back (solref's time constant); MuJoCo takes
            two steps at least.
        impedance: of a contact, where it begins and where it is 1 mm deep (solimp), below 1: what is missing
            to 1 is how much of a load a contact lets slip.
        impratio: how much harder friction is than the contact's normal, which keeps a held object from
            creeping out of the fingers.
        noslip_iterations: of the solver that undoes what slip is left, 0 for none.
        condim: 3: contacts slide; 4: they resist turning about their normal, too; 6: and rolling.
        torsion: metres by which friction becomes resistance to turning, the radius of a contact's patch.
        rolling: metres by which friction becomes resistance to rolling, with condim 6.
    """

    name: ClassVar[str] = "mujoco"

    substeps: int = 8
    softness: float = 0.005
    impedance: tuple[float, float] = (0.95, 0.99)
    impratio: float = 10.0
    noslip_iterations: int = 0
    condim: int = 4
    torsion: float = 0.005
    rolling: float = 0.0001

    def __post_init__(self) -> None:
        check_whole("substeps", self.substeps, 1)
        check_whole("noslip_iterations", self.noslip_iterations, 0)
        for name in ("softness", "impratio"):
            check_range(name, getattr(self, name), 0.0, float("inf"), open_low=True)
        for name in ("torsion", "rolling"):
            check_range(name, getattr(self, name), 0.0, float("inf"))
        if self.condim not in (3, 4, 6):
            raise ConfigError(f"condim={self.condim} is unknown: give 3, 4 or 6.")
        if not isinstance(self.impedance, Sequence) or len(self.impedance) != 2:
            raise ConfigError(f"impedance={self.impedance} is no pair: give [at the surface, 1 mm deep].")
        for i, value in enumerate(self.impedance):
            check_range(f"impedance[{i}]", value, 0.0, 0.9999, open_low=True)
        object.__setattr__(self, "impedance", tuple(self.impedance))

    def build(self, placement: Placement) -> World:
        """A scene in MuJoCo; the compiled model of an object is kept for its next episode."""
        contact = Contact(
            condim=self.condim,
            torsion=self.torsion,
            rolling=self.rolling,
            solref=(self.softness, 1.0),
            solimp=(*self.impedance, 1e-3, 0.5, 2.0),
            impratio=self.impratio,
            noslip_iterations=self.noslip_iterations,
        )
        return MujocoWorld(placement, contact, substeps=self.substeps)

    def check(self) -> None:
        """Import mujoco."""
        load_mujoco()
