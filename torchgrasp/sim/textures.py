"""Procedural textures: noise, checkers, stripes and gradients between two colours, from a generator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

TEXTURE_SIZE = 128
_Pattern = Callable[[np.random.Generator], NDArray]


def draw_texture(rng: np.random.Generator, low: NDArray, high: NDArray) -> NDArray[np.uint8]:
    """A texture of one of the patterns, its own turn and scale.

    Args:
        rng: of all choices.
        low: (3,) colour in [0, 1] where the pattern is 0.
        high: (3,) colour where it is 1.

    Returns:
        (128, 128, 4) uint8, opaque; mirrored where it repeats.
    """
    pattern = _PATTERNS[rng.integers(len(_PATTERNS))]
    return colour_texture(pattern(rng), low, high)


def colour_texture(pattern: NDArray, low: NDArray, high: NDArray) -> NDArray[np.uint8]:
    """(S, S) values in [0, 1] to an opaque (S, S, 4) uint8 texture from colour `low` to `high`."""
    colour = low + pattern[..., None] * (high - low)
    opaque = np.concatenate((colour, np.ones_like(colour[..., :1])), axis=-1)
    return np.round(np.clip(opaque, 0.0, 1.0) * 255).astype(np.uint8)


def wood(rng: np.random.Generator) -> NDArray:
    """(S, S) grain along the texture's rows."""
    grain = smooth_noise(rng, (48, 3)) * 0.6 + smooth_noise(rng, (96, 6)) * 0.25
    return np.clip(grain + 0.15 * rng.random((TEXTURE_SIZE, TEXTURE_SIZE)), 0.0, 1.0)


def smooth_noise(rng: np.random.Generator, cells: tuple[int, int]) -> NDArray:
    """(S, S) random values in [0, 1] on a grid of `cells`, interpolated, periodic."""
    grid = rng.random(cells)
    for axis, count in enumerate(cells):
        at = np.arange(TEXTURE_SIZE) * count / TEXTURE_SIZE
        first, share = at.astype(int), at % 1.0
        share = share * share * (3.0 - 2.0 * share)
        share = share[:, None] if axis == 0 else share[None, :]
        grid = grid.take(first, axis) * (1 - share) + grid.take((first + 1) % count, axis) * share
    return grid


def _noise(rng: np.random.Generator) -> NDArray:
    cells = int(rng.integers(2, 9))
    octaves = [smooth_noise(rng, (cells * 2**i, cells * 2**i)) / 2**i for i in range(3)]
    return np.sum(octaves, axis=0) / 1.75


def _waves(rng: np.random.Generator, num: int) -> list[NDArray]:
    """`num` phases (S, S) that grow along directions at right angles, some waves across the texture."""
    angle, count = rng.uniform(0.0, np.pi), rng.uniform(2.0, 12.0)
    y, x = np.mgrid[:TEXTURE_SIZE, :TEXTURE_SIZE] / TEXTURE_SIZE
    turns = angle + np.arange(num) * np.pi / 2
    return [count * (x * np.cos(turn) + y * np.sin(turn)) + rng.random() for turn in turns]


def _checkers(rng: np.random.Generator) -> NDArray:
    a, b = _waves(rng, 2)
    return ((np.floor(a) + np.floor(b)) % 2).astype(np.float64)


def _stripes(rng: np.random.Generator) -> NDArray:
    (a,) = _waves(rng, 1)
    return (a % 1.0 < rng.uniform(0.2, 0.8)).astype(np.float64)


def _gradient(rng: np.random.Generator) -> NDArray:
    (a,) = _waves(rng, 1)
    return (a - a.min()) / np.ptp(a)


_PATTERNS: tuple[_Pattern, ...] = (_noise, _checkers, _stripes, _gradient)
