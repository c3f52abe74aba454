"""What stands at each place of a configuration that is built, and which classes a file may name there.

Hydra calls whatever a `_target_` names. For the user's own configuration that is wanted: a class of any
package does, as long as it is of the kind that its place expects. A file from somebody else is data: only
classes that are defined in torchgrasp, in the listed modules of TorchRL, or in a package that the user trusts
are built of it.
"""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.envs import EnvBase, Transform
from torchrl.objectives import LossModule

from torchgrasp.data import CompactTransitions, Priority
from torchgrasp.envs import Start, TargetMotion
from torchgrasp.errors import ConfigError
from torchgrasp.objectives import PoseDistance
from torchgrasp.objects import ObjectSet
from torchgrasp.planning import GoalChoice, Law, Planner, PoseNoise
from torchgrasp.rollouts import EpisodePool
from torchgrasp.sim import Camera, CameraIntrinsics, Engine, LookAt, Physics, Randomization


@dataclass(frozen=True)
class PartKind:
    """What may stand at a place.

    Attributes:
        base: class that the part is of.
        optional: whether null may stand there instead.
        partial: whether the class itself is handed on, its other arguments bound (`_partial_: true`).
        plain: whether plain values may stand there instead, of which the part's owner knows the meaning.
    """

    base: type
    optional: bool = False
    partial: bool = False
    plain: bool = False


_MODULE = PartKind(TensorDictModuleBase)
# Places by pattern; `*` is one key.
_KINDS: dict[str, PartKind] = {
    "env": PartKind(EnvBase),
    "env.start": PartKind(Start),
    "env.physics": PartKind(Physics),
    "env.target_motion": PartKind(TargetMotion, plain=True),
    "engine": PartKind(Engine, optional=True),
    "objects": PartKind(ObjectSet),
    "objects.sets.*": PartKind(ObjectSet),
    "camera": PartKind(Camera),
    "overhead": PartKind(Camera, optional=True),
    **{f"{camera}.intrinsics": PartKind(CameraIntrinsics) for camera in ("camera", "overhead")},
    **{f"{camera}.randomize": PartKind(Randomization, optional=True) for camera in ("camera", "overhead")},
    **{
        f"{camera}.{pose}": PartKind(LookAt, optional=True, plain=True)
        for camera in ("camera", "overhead")
        for pose in ("T_base_camera", "T_ee_camera")
    },
    "transforms.*": PartKind(Transform),
    "transforms.*.intrinsics": PartKind(CameraIntrinsics, optional=True),
    "expert": _MODULE,
    "expert.planner": PartKind(Planner, optional=True),
    "expert.planner.choice": PartKind(GoalChoice),
    "expert.law": PartKind(Law, optional=True),
    "expert.fallback": PartKind(Planner, optional=True),
    "expert.fallback.choice": PartKind(GoalChoice),
    "planning": _MODULE,
    "planning.planner": PartKind(Planner),
    "planning.planner.choice": PartKind(GoalChoice),
    "planning.pose_noise": PartKind(PoseNoise, optional=True),
    "collector.pool": PartKind(EpisodePool),
    # Left out on purpose by some recipes, which say so themselves (config/exploration.py).
    **{
        f"collector.{name}": PartKind(TensorDictModuleBase, optional=True)
        for name in ("noise", "tries", "expert_start", "disturb", "disturb_to_fail")
    },
    "model.encoder": PartKind(nn.Module, partial=True),
    "model.*.encoder": PartKind(nn.Module, partial=True),
    **{f"model.{name}": _MODULE for name in ("actor", "critic", "goal_network")},
    "loss": PartKind(LossModule),
    "loss.distance": PartKind(PoseDistance),
    "loss.goal_distance": PartKind(PoseDistance),
    "replay.codec": PartKind(CompactTransitions),
    "replay.augment": PartKind(Transform, optional=True),
    "replay.priority": PartKind(Priority, optional=True),
}

# TorchRL's classes whose constructors compute on plain values and do nothing else. Left out are those that
# start processes (MCP tools, VC1), load from the internet (R3M, VIP, Tokenizer) or write files (loggers).
_TORCHRL = (
    *(
        f"torchrl.envs.transforms.{module}."
        for module in ("_action", "_clip", "_device", "_env", "_keys", "_misc", "_normalization")
    ),
    *(f"torchrl.envs.transforms.{module}." for module in ("_observation", "_reward", "_timer", "vecnorm")),
    "torchrl.envs.transforms.rb_transforms.",
    "torchrl.envs.transforms._tensor.CatTensors",
    "torchrl.envs.transforms._tensor.Stack",
    "torchrl.modules.models.",
    "torchrl.objectives.",
)
_IMPORTED_FROM_TORCHRL = ("torchrl.envs.", "torchrl.modules.", "torchrl.objectives.")
_NAME = re.compile(r"[A-Za-z]\w*(\.[A-Za-z]\w*)+")
_REFERENCE = re.compile(r"\$\{\w+(\.\w+)*\}")
_DEPTH = 20  # levels of a configuration; ours have six


def check_parts(cfg: Mapping[str, Any]) -> None:
    """Refuse what cannot stand where a part is expected in the user's own configuration, by its place.

    Args:
        cfg: resolved plain values.

    Raises:
        ConfigError: where something else than a part stands there, or nothing, or no class of that kind.
    """
    for place, node in _find_places("", cfg):
        kind = _kind_of(place)
        if kind is None or (node is None and kind.optional):
            continue
        if isinstance(node, Mapping) and "_target_" in node:
            _check_class(place, _import(place, node["_target_"]), kind)
        elif not kind.plain or node is None:
            null = " or null" if kind.optional else ""
            raise ConfigError(
                f"{place}={node}: give a {kind.base.__name__}, as {{_target_: <its class>, <options>}}{null}."
            )


def check_strangers_parts(config: Mapping[str, Any], file: str, trust: Iterable[str] = ()) -> None:
    """Refuse a file's configuration that names anything but known classes at the places where they belong.

    Nothing is called. Modules of torchgrasp, TorchRL and the trusted packages are imported, no others. Below
    a trusted class any class of the trusted packages may stand.

    Args:
        config: plain values as they were read.
        file: what they were read from, for the message.
        trust: packages besides torchgrasp and TorchRL whose classes may be named.

    Raises:
        ConfigError: names the place, what stands there, and what to do.
    """
    trusted = tuple(f"{package}." for package in trust)
    for place, node in _find_places("", config):
        if isinstance(node, str) and "${" in node:
            raise ConfigError(f"{file} holds a reference, {place}={node}: give a file with plain values.")
        if isinstance(node, Mapping) and any(str(key).startswith("_") for key in node):
            try:
                _check_strangers_node(place, node, trusted)
            except ConfigError as error:
                raise ConfigError(f"{file} could run anything: {error}") from error


def check_references(config: Mapping[str, Any], file: str) -> None:
    """Refuse references in a file's configuration, but for plain ones to its own values, as `${a.b}`.

    Raises:
        ConfigError: names the place, and what stands there.
    """
    for place, node in _find_places("", config):
        if isinstance(node, str) and "${" in node and not _REFERENCE.fullmatch(node):
            raise ConfigError(
                f"{file} could run anything: {place}={node} is more than a reference to a value."
            )


def _check_strangers_node(place: str, node: Mapping[str, Any], trusted: tuple[str, ...]) -> None:
    kind, target = _kind_of(place), node.get("_target_")
    special = sorted(str(key) for key in node if str(key).startswith("_"))
    if set(special) - {"_target_", "_partial_"} or (
        kind and node.get("_partial_", False) is not kind.partial
    ):
        raise ConfigError(f"{place} has {', '.join(special)}, which does not belong there.")
    allowed = (*(("torchgrasp.", *_IMPORTED_FROM_TORCHRL) if kind else ()), *trusted)
    if not (isinstance(target, str) and _NAME.fullmatch(target) and target.startswith(allowed)):
        raise ConfigError(
            f"{place} names {target}. If you know who made the file and what that does, add "
            f"trust=[{str(target).split('.')[0]}]."
        )
    found = _import(place, target)
    home = f"{getattr(found, '__module__', '')}.{getattr(found, '__qualname__', '')}"
    known = (*(("torchgrasp.", *_TORCHRL) if kind else ()), *trusted)
    if not inspect.isclass(found) or not home.startswith(known):
        raise ConfigError(
            f"{place} names {target}, which is no class of torchgrasp or of TorchRL that may stand there."
        )
    if kind:
        _check_class(place, found, kind)


def _check_class(place: str, found: Any, kind: PartKind) -> None:
    if not (inspect.isclass(found) and issubclass(found, kind.base)):
        name = f"{getattr(found, '__module__', '')}.{getattr(found, '__qualname__', found)}".lstrip(".")
        raise ConfigError(f"{place}._target_={name} is no {kind.base.__name__}: name a class of that kind.")


def _kind_of(place: str) -> PartKind | None:
    depth = place.count(".")
    return next(
        (kind for at, kind in _KINDS.items() if at.count(".") == depth and fnmatchcase(place, at)), None
    )


def _find_places(place: str, node: Any, depth: int = 0) -> Iterable[tuple[str, Any]]:
    """Every value below a node with its dotted place, outer ones first."""
    if depth > _DEPTH:
        raise ConfigError(f"{place} lies more than {_DEPTH} levels deep: give a configuration of a recipe.")
    if depth:
        yield place, node
    inner: Iterable[tuple[Any, Any]] = ()
    if isinstance(node, Mapping):
        inner = node.items()
    elif isinstance(node, list | tuple):
        inner = enumerate(node)
    for key, value in inner:
        yield from _find_places(f"{place}.{key}" if place else str(key), value, depth + 1)


def _import(place: str, target: Any) -> Any:
    """What a dotted name stands for."""
    try:
        return pkgutil.resolve_name(str(target))
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(
            f"{place}._target_={target} cannot be imported ({error}): give the dotted name of a class that "
            "is installed, or on PYTHONPATH."
        ) from error
