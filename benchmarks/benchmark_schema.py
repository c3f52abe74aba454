"""The plain values of benchmark.yaml, typed."""

from __future__ import annotations

from typing import Annotated, Literal

from torchgrasp.config.schema import Env, OpenSection
from torchgrasp.config.value_types import Count, Device, Positive, at_least, between


class Clouds(OpenSection):
    """Of the suites `encoder` and `update`."""

    batch: Positive
    points: Positive
    repeats: Positive
    threads: Positive


class Learner(OpenSection):
    """Of the suite `learner`."""

    experiments: list[str]
    ways: list[str]
    overrides: list[str]
    transitions: Positive
    repeats: Positive
    profile: list[str]


class Neighbours(OpenSection):
    """Of the suite `neighbours`."""

    batch: Positive
    points: Positive
    seconds: Annotated[float, between(0.01, 600.0)]


class Training(OpenSection):
    """Of the suite `training`."""

    workers: list[Count]
    collectors: list[Literal["pool", "ray"]]
    iterations: Positive
    warmup: Count


class Scale(OpenSection):
    """Of the suite `scale`."""

    experiment: str
    overrides: list[str]
    batches: list[Positive]
    points: list[Positive]
    workers: list[Positive] | None
    repeats: Positive
    rounds: Positive


class Critics(OpenSection):
    """Of the suite `critics`."""

    policy: str
    overrides: list[str]
    episodes: Positive
    held_out: Positive
    states: Positive
    tries: Positive
    first: Count
    reach: Annotated[float, between(0.0, 10.0)]
    gamma: Annotated[float, between(0.0, 1.0)]
    updates: Positive
    learning_rate: Annotated[float, between(1e-9, 1.0)]
    ways: list[str]


class Agent(OpenSection):
    """Of the suite `agent`."""

    policy: str
    objects: Positive
    worlds: Positive
    episodes: Positive
    timed: Positive
    scenes: Positive


class Export(OpenSection):
    """Of the suite `export`."""

    policy: str
    objects: Positive
    states: Positive


class Franka(OpenSection):
    """Of the suite `franka`."""

    policy: str
    split: Literal["train", "val", "test"]
    objects: Positive
    episodes: Positive
    results: str
    watchdog: Annotated[float, between(0.001, 60.0)]
    film: str | None


class Workers(OpenSection):
    """Who prepares objects."""

    num_workers: Count


class Benchmark(OpenSection):
    """benchmark.py."""

    seed: Count
    num_points: Positive
    device: Device
    episodes: Positive
    batch: Positive
    resets: Annotated[int, at_least(10)]  # memory is read after each tenth
    scenes: Positive
    transitions: Positive
    draws: Positive
    clouds: Clouds
    learner: Learner
    neighbours: Neighbours
    training: Training
    scale: Scale
    critics: Critics
    agent: Agent
    export: Export
    franka: Franka
    env: Env
    collector: Workers
