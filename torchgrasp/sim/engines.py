"""Engines by name."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import signature
from typing import Any, Literal

from torchgrasp.errors import ConfigError
from torchgrasp.sim.engine import Engine
from torchgrasp.sim.mujoco.mujoco_engine import MujocoEngine
from torchgrasp.sim.sapien_world import SapienEngine

EngineName = Literal["sapien", "mujoco"]
_ENGINES: dict[str, type[Engine]] = {each.name: each for each in (SapienEngine, MujocoEngine)}
_OURS = "torchgrasp.sim."


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


def describe_engine(told: Mapping[str, Any] | None) -> dict[str, Any]:
    """An engine's configuration with every option in it: engines that do the same compare equal.

    Options that are left out have their defaults, pairs are lists, and None is SAPIEN's, the engine of
    configurations that name none. A class that is not ours keeps the options that are told.
    ConfigError tells what is no mapping.

    >>> describe_engine({"_target_": "torchgrasp.sim.MujocoEngine", "impedance": (0.9, 0.99)})["impedance"]
    [0.9, 0.99]
    """
    if told is not None and not isinstance(told, Mapping):
        raise ConfigError(f"engine={told!r} is no engine's configuration: give its _target_ and options.")
    told = dict(told or {"_target_": f"{_OURS}{SapienEngine.__name__}"})
    target = str(told.pop("_target_", ""))
    kinds = {kind.__name__: kind for kind in _ENGINES.values()} if target.startswith(_OURS) else {}
    if (kind := kinds.get(target.rpartition(".")[2])) is not None:
        target = _OURS + kind.__name__
        told = {name: each.default for name, each in signature(kind).parameters.items()} | told
    plain = {name: list(each) if isinstance(each, tuple) else each for name, each in told.items()}
    return {"_target_": target, **plain}
