"""Physics: what the worlds are made of, fixed or drawn anew for every episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np

from torchgrasp.errors import ConfigError, check_range

# What may differ from episode to episode.
_DRAWN = ("mass", "friction", "finger_friction", "finger_force")
_ABOVE_ZERO = (
    *("mass", "finger_force", "control_period", "close_seconds", "lift_seconds", "lift_height"),
    *("free_rate", "approach_rate", "close_rate", "lift_rate"),
)
_FROM_ZERO = ("friction", "finger_friction", "linear_damping", "angular_damping", "near")


@dataclass(frozen=True)
class Physics:
    """What the world is made of. By default every object has the same mass and friction (Sec. 6.2).

    Attributes:
        mass: of the target, kg.
        friction: static and dynamic, of target and table.
        finger_friction: of the finger pads.
        finger_force: with which each finger closes, N.
        linear_damping, angular_damping: of the target, 1/s. PhysX knows no rolling friction; without
            an angular damping of this size round objects roll for ever.
        control_period: seconds a step of the policy lasts (released code: 0.15).
        free_rate: physics steps a second while the hand moves far from the target.
        approach_rate: the same while the hand is within `near` of the target.
        near: metres between the hand's box and the target's surface.
        close_rate, lift_rate: physics steps a second while the fingers close and while they lift.
        close_seconds, lift_seconds: duration of the two; closing ends earlier once the fingers stand.
        lift_height: metres that the hand rises at the end.
        vary: ranges (low, high) of mass, friction, finger_friction, finger_force: each episode then draws
            a value of its own, uniformly. Resting poses are proved with the values above.
    """

    mass: float = 0.15
    friction: float = 1.0
    finger_friction: float = 2.0
    finger_force: float = 40.0
    linear_damping: float = 0.1
    angular_damping: float = 10.0
    control_period: float = 0.15
    free_rate: int = 60
    approach_rate: int = 120
    near: float = 0.02
    close_rate: int = 120
    lift_rate: int = 120
    close_seconds: float = 0.4
    lift_seconds: float = 0.9
    lift_height: float = 0.15
    vary: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in (*_ABOVE_ZERO, *_FROM_ZERO):
            check_range(name, getattr(self, name), 0.0, np.inf, open_low=name in _ABOVE_ZERO)
        pairs = {name: _pair(name, each) for name, each in self.vary.items() if each is not None}
        object.__setattr__(self, "vary", pairs)
        for name, (low, _) in pairs.items():
            check_range(f"vary[{name!r}][0]", low, 0.0, np.inf, open_low=name in _ABOVE_ZERO)

    def draw(self, rng: np.random.Generator) -> Physics:
        """The physics of one episode: what varies is drawn, nothing varies any more."""
        drawn = {name: float(rng.uniform(*self.vary[name])) for name in _DRAWN if name in self.vary}
        return replace(self, **drawn, vary={})


def _pair(name: str, pair: object) -> tuple[float, float]:
    """(low, high) of a range, or an error that names it."""
    if name not in _DRAWN:
        raise ConfigError(f"vary has {name!r}: only {', '.join(_DRAWN)} can vary.")
    whole = isinstance(pair, Sequence) and len(pair) == 2 and all(isinstance(each, Real) for each in pair)
    if not whole or not -np.inf < pair[0] <= pair[1] < np.inf:  # type: ignore[index]
        raise ConfigError(f"vary[{name!r}]={pair!r}: give [low, high], or null for a fixed value.")
    return float(pair[0]), float(pair[1])  # type: ignore[index]
