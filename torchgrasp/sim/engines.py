"""Engines by name."""

from __future__ import annotations

from typing import Literal

from torchgrasp.errors import ConfigError
from torchgrasp.sim.engine import Engine
from torchgrasp.sim.mujoco.mujoco_engine import MujocoEngine
from torchgrasp.sim.sapien_world import SapienEngine

EngineName = Literal["sapien", "mujoco"]
_ENGINES: dict[str, type[Engine]] = {each.name: each for each in (SapienEngine, MujocoEngine)}


def make_engine(engine: Engine | EngineName = "sapien") -> Engine:
    """The engine of that name with its own options, or the engine itself.

    Raises:
        ConfigError: where no engine has that name.
        MissingPackageError: where the engine's package is not installed.
    """
    if isinstance(engine, str):
        if engine not in _ENGINES:
            raise ConfigError(f"engine={engine!r} is unknown: give {' or '.join(_ENGINES)}.")
        engine = _ENGINES[engine]()
    if not isinstance(engine, Engine):
        raise ConfigError(f"engine={engine!r} is no Engine: give {' or '.join(_ENGINES)}, or an Engine.")
    engine.check()
    return engine
