"""How the target moves before it is grasped: not at all, by jumps on the table, or in a person's hand."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np

from torchgrasp.errors import ConfigError, check_range

Moves = np.ndarray  # (K, 3): metres along x and y of the base, radians about z, at the first K steps
Route = Literal["left", "middle", "right", "left_to_right", "right_to_left"]
ROUTES: tuple[Route, ...] = get_args(Route)

# Where a route begins and ends: 1 left, 0 middle, -1 right.
_ENDS = {
    "left": (1, 1),
    "middle": (0, 0),
    "right": (-1, -1),
    "left_to_right": (1, -1),
    "right_to_left": (-1, 1),
}
_STILL: Moves = np.zeros((0, 3))


class Presentation(NamedTuple):
    """How the target is presented in one episode.

    Attributes:
        T_base_object: (4, 4) pose in which the episode begins.
        moves: that follow, at the first steps.
        held: whether it is held in the air until the fingers have closed, rather than put on the table.
    """

    T_base_object: np.ndarray
    moves: Moves
    held: bool = False


class TargetMotion(ABC):
    """Where the target is presented, and its moves at the first steps of an episode."""

    @abstractmethod
    def present(self, rng: np.random.Generator, T_base_object: np.ndarray, area: tuple) -> Presentation:
        """How an episode begins and goes on.

        Args:
            rng: of the draws.
            T_base_object: (4, 4) pose at rest on the table.
            area: ((low, high) of x, (low, high) of y) of the table's part in use, metres, base frame.
        """


class StaticTarget(TargetMotion):
    """The target lies still."""

    def present(self, rng: np.random.Generator, T_base_object: np.ndarray, area: tuple) -> Presentation:
        """See `TargetMotion.present`."""
        return Presentation(T_base_object, _STILL)


@dataclass(frozen=True)
class JitterTarget(TargetMotion):
    """The target is put elsewhere on the table at each of the first steps (Sec. 6.6).

    Attributes:
        steps: that begin with a move (Sec. 6.6: 12).
        translation: largest move along x and along y, metres (Sec. 6.6: 3 cm).
        rotation: largest turn about z, radians (Sec. 6.6: 15 degrees).
    """

    steps: int = 12
    translation: float = 0.03
    rotation: float = float(np.deg2rad(15.0))

    def __post_init__(self) -> None:
        _check_steps(self.steps, 0)
        check_range("translation", self.translation, 0.0, 0.5)
        check_range("rotation", self.rotation, 0.0, np.pi)

    def present(self, rng: np.random.Generator, T_base_object: np.ndarray, area: tuple) -> Presentation:
        """See `TargetMotion.present`; the target stays in the area."""
        scale = np.array([self.translation, self.translation, self.rotation])
        moves = rng.uniform(-1, 1, (self.steps, 3)) * scale
        place = T_base_object[:2, 3]
        for move in moves:
            after = np.clip(place + move[:2], [low for low, _ in area], [high for _, high in area])
            move[:2], place = after - place, after
        return Presentation(T_base_object, moves)


@dataclass(frozen=True)
class HandoverTarget(TargetMotion):
    """The target is held out to the robot, at rest or on its way across (handover, Sec. 6.7, Table 7).

    It is held where it is told to be, whatever touches it, until the fingers have closed. Left is the
    robot's own, y > 0. The person's hand is not modelled.

    Attributes:
        route: where it is held, or from where to where it moves; ``random`` draws one of the five.
        side: y of left and right, metres.
        x, z: ranges of its place, metres, base frame.
        tilt: largest turn away from how it would lie on the table, radians.
        steps: of a move from one side to the other.
    """

    route: Route | Literal["random"] = "random"
    side: float = 0.2
    x: tuple[float, float] = (0.45, 0.60)
    z: tuple[float, float] = (0.25, 0.40)
    tilt: float = 0.5
    steps: int = 15

    def __post_init__(self) -> None:
        if self.route != "random" and self.route not in ROUTES:
            raise ConfigError(f"route={self.route!r}: give random or one of {', '.join(ROUTES)}.")
        check_range("side", self.side, 0.0, 0.5)
        check_range("tilt", self.tilt, 0.0, np.pi)
        _check_steps(self.steps, 1)
        for name, (low, high) in (("x", (0.2, 0.8)), ("z", (0.05, 1.0))):
            pair = getattr(self, name)
            if isinstance(pair, (int, float)) or len(pair) != 2:
                raise ConfigError(f"{name}={pair}: give [low, high], metres.")
            check_range(f"{name}[0]", pair[0], low, high)
            check_range(f"{name}[1]", pair[1], pair[0], high)

    def present(self, rng: np.random.Generator, T_base_object: np.ndarray, area: tuple) -> Presentation:
        """See `TargetMotion.present`; a move speeds up and slows down like a cosine."""
        drawn = ROUTES[rng.integers(len(ROUTES))]
        route = drawn if self.route == "random" else self.route
        first, last = _ENDS[route]
        pose = T_base_object.copy()
        pose[:3, :3] = _tilted(rng, self.tilt) @ T_base_object[:3, :3]
        pose[:3, 3] = rng.uniform(*self.x), first * self.side, rng.uniform(*self.z)
        if first == last:
            return Presentation(pose, _STILL, held=True)
        shares = (1.0 - np.cos(np.linspace(0.0, np.pi, self.steps + 1))) / 2
        moves = np.zeros((self.steps, 3))
        moves[:, 1] = np.diff(shares) * (last - first) * self.side
        return Presentation(pose, moves, held=True)


@dataclass(frozen=True)
class MixedTarget(TargetMotion):
    """Each episode has one of several motions: for policies that are to meet them all.

    Attributes:
        motions: what is drawn from.
        weights: of the draw, one a motion.
    """

    motions: Sequence[TargetMotion] = field(
        default_factory=lambda: (StaticTarget(), JitterTarget(), HandoverTarget())
    )
    weights: Sequence[float] = (2.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        usable = len(self.motions) == len(self.weights) and all(weight >= 0 for weight in self.weights)
        if not usable or not 0.0 < sum(self.weights) < np.inf:
            raise ConfigError(
                f"weights={list(self.weights)}: give each of the {len(self.motions)} motions a "
                "weight of at least 0, one of them more."
            )

    def present(self, rng: np.random.Generator, T_base_object: np.ndarray, area: tuple) -> Presentation:
        """See `TargetMotion.present`."""
        shares = np.asarray(self.weights) / sum(self.weights)
        return self.motions[rng.choice(len(self.motions), p=shares)].present(rng, T_base_object, area)


def _check_steps(steps: int, least: int) -> None:
    if not isinstance(steps, int) or steps < least:
        raise ConfigError(f"steps={steps}: give a whole number of at least {least}.")


def _tilted(rng: np.random.Generator, largest: float) -> np.ndarray:
    """(3, 3) turn of up to `largest` radians about a horizontal axis."""
    azimuth, angle = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, largest)
    x, y, c, s = np.cos(azimuth), np.sin(azimuth), np.cos(angle), np.sin(angle)
    return np.array(
        [
            [c + x * x * (1 - c), x * y * (1 - c), y * s],
            [x * y * (1 - c), c + y * y * (1 - c), -x * s],
            [-y * s, x * s, c],
        ]
    )


def moved(T_base_object: np.ndarray, move: np.ndarray) -> np.ndarray:
    """(4, 4) pose shifted by (3,) = (x, y, yaw), turned about its own origin."""
    c, s = np.cos(move[2]), np.sin(move[2])
    out = T_base_object.copy()
    out[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ T_base_object[:3, :3]
    out[:2, 3] += move[:2]
    return out


def make_target_motion(
    target_motion: TargetMotion | Literal["static", "jitter", "handover", "mixed"],
) -> TargetMotion:
    """The motion itself, or that of the name with its usual numbers."""
    if isinstance(target_motion, TargetMotion):
        return target_motion
    named = {"static": StaticTarget, "jitter": JitterTarget, "handover": HandoverTarget, "mixed": MixedTarget}
    if target_motion not in named:
        raise ConfigError(
            f"target_motion={target_motion!r} is unknown: give {', '.join(named)} or a TargetMotion."
        )
    return named[target_motion]()
