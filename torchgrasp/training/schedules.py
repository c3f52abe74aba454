"""Schedules: learning-rate factors for LambdaLR, and values that change with training."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence

from torchgrasp.errors import ConfigError, check_range

Schedule = Callable[[int], float]


def step_schedule(milestones: Sequence[int], gamma: float = 0.3) -> Schedule:
    """Piecewise constant factor of Sec. 6.4: multiplied by `gamma` at each milestone.

    >>> factor = step_schedule([1000, 2000], gamma=0.5)
    >>> [factor(step) for step in (0, 999, 1000, 2500)]
    [1.0, 1.0, 0.5, 0.25]
    """
    steps = list(milestones)
    if steps != sorted(set(steps)):
        raise ConfigError(f"milestones={steps} must increase: give each step once, in order.")
    check_range("gamma", gamma, 0.0, float("inf"), open_low=True)
    return lambda step: float(gamma ** bisect.bisect_right(steps, step))


def cosine_schedule(num_steps: int, *, warmup_steps: int = 0, final: float = 0.0) -> Schedule:
    """Linear rise to 1 over `warmup_steps`, then half a cosine down to `final` at `num_steps`.

    >>> factor = cosine_schedule(110, warmup_steps=10)
    >>> [round(factor(step), 3) for step in (0, 9, 60, 110, 999)]
    [0.1, 1.0, 0.5, 0.0, 0.0]
    """
    if not 0 <= warmup_steps < num_steps:
        raise ConfigError(f"warmup_steps={warmup_steps} must lie in [0, num_steps={num_steps}).")

    def factor(step: int) -> float:
        if step < warmup_steps:
            return (step + 1) / warmup_steps
        progress = min((step - warmup_steps) / (num_steps - warmup_steps), 1.0)
        return final + (1.0 - final) * 0.5 * (1.0 + math.cos(math.pi * progress))

    return factor


def linear_schedule(start: float, end: float, num_steps: int) -> Schedule:
    """Value on the straight line from `start` at step 0 to `end` from `num_steps` on.

    Sec. 6.4's exploration noise falls so, from 3 cm to 0.5 cm.

    >>> noise = linear_schedule(0.03, 0.005, 100)
    >>> [round(noise(step), 4) for step in (0, 50, 100, 200)]
    [0.03, 0.0175, 0.005, 0.005]
    """
    if num_steps < 1:
        raise ConfigError(f"num_steps={num_steps}: give at least 1.")
    return lambda step: start + (end - start) * min(max(step / num_steps, 0.0), 1.0)
