"""What a rendered world looks like: textures of its things and its light, by default or drawn."""

from __future__ import annotations

import colorsys
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.sim.textures import TEXTURE_SIZE, colour_texture, draw_texture, wood

Range = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Appearance:
    """One look of a world; colours are linear RGB in [0, 1].

    Attributes:
        target, table, floor: (S, S, 4) uint8 textures.
        robot: (3,) tint of the robot's links.
        light_from: (3,) direction in the base frame from which the main light comes, z > 0.
        light: (3,) its colour times its strength.
        ambient: (3,) light from everywhere; also the colour of the background.
    """

    target: NDArray[np.uint8]
    table: NDArray[np.uint8]
    floor: NDArray[np.uint8]
    robot: NDArray
    light_from: NDArray
    light: NDArray
    ambient: NDArray


@dataclass(frozen=True)
class Randomization:
    """Ranges from which an episode's look is drawn: domain randomisation for images (Sec. 6.2).

    Attributes:
        textures: whether target, table and floor get random textures; else they keep the default ones.
        brightness: of texture colours, 0 to 1.
        robot: of the tint of the robot's links, 0 to 1.
        light: strength of the main light.
        light_tint: largest relative change of each of the light's colour channels.
        light_tilt: radians between the vertical and the main light.
        ambient: strength of the light from everywhere.
    """

    textures: bool = True
    brightness: Range = (0.05, 0.95)
    robot: Range = (0.3, 1.0)
    light: Range = (0.6, 2.4)
    light_tint: float = 0.2
    light_tilt: Range = (0.0, 1.1)
    ambient: Range = (0.15, 0.6)

    def __post_init__(self) -> None:
        tops = {"brightness": 1.0, "robot": 1.0, "light": np.inf, "light_tilt": 1.4, "ambient": np.inf}
        for name, top in tops.items():
            pair = tuple(getattr(self, name))
            if len(pair) != 2:
                raise ConfigError(f"{name}={list(pair)}: give a pair [low, high].")
            object.__setattr__(self, name, pair)  # lists of a configuration have no hash
            check_range(f"{name}[0]", pair[0], 0.0, top)
            check_range(f"{name}[1]", pair[1], pair[0], top)
        check_range("light_tint", self.light_tint, 0.0, 1.0)

    def draw(self, appearance: int, target_key: str) -> Appearance:
        """The look that follows from an episode's seed `appearance`, the same at every call."""
        rng = np.random.default_rng((appearance, 0x5EE))
        plain = default_appearance(target_key)
        target, table, floor = (self._texture(rng) for _ in range(3))
        return Appearance(
            target=target if self.textures else plain.target,
            table=table if self.textures else plain.table,
            floor=floor if self.textures else plain.floor,
            robot=rng.uniform(*self.robot) * rng.uniform(0.8, 1.0, 3),
            light_from=self._direction(rng),
            light=rng.uniform(*self.light) * rng.uniform(1 - self.light_tint, 1 + self.light_tint, 3),
            ambient=rng.uniform(*self.ambient) * rng.uniform(1 - self.light_tint, 1 + self.light_tint, 3),
        )

    def _texture(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        low, high = rng.uniform(*self.brightness, (2, 3))
        return draw_texture(rng, low, high)

    def _direction(self, rng: np.random.Generator) -> NDArray:
        tilt, turn = rng.uniform(*self.light_tilt), rng.uniform(0.0, 2 * np.pi)
        return np.array((np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)))


@functools.lru_cache(maxsize=64)
def default_appearance(target_key: str) -> Appearance:
    """The look without randomisation: a wooden table, a grey floor, light from above.

    Args:
        target_key: the target's content hash, from which its colour follows.
    """
    hue = int(target_key[:8], 16) / 16**8
    colour = np.array(colorsys.hsv_to_rgb(hue, 0.65, 0.85))
    flat = np.full((TEXTURE_SIZE, TEXTURE_SIZE), 1.0)
    table, floor = _surroundings()
    return Appearance(
        target=colour_texture(flat, colour, colour),
        table=table,
        floor=floor,
        robot=np.array((1.0, 1.0, 1.0)),
        light_from=np.array((-0.35, 0.45, 1.0)),
        light=np.array((1.6, 1.55, 1.5)),
        ambient=np.array((0.45, 0.46, 0.48)),
    )


@functools.cache
def _surroundings() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The default textures of table and floor."""
    rng = np.random.default_rng(7)
    table = colour_texture(wood(rng), np.array((0.52, 0.38, 0.25)), np.array((0.74, 0.59, 0.43)))
    floor = colour_texture(rng.random((TEXTURE_SIZE,) * 2), np.full(3, 0.42), np.full(3, 0.46))
    return table, floor
