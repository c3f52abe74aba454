"""The transforms of a trained policy for one arm and a camera of its own, outside of an environment."""

from __future__ import annotations

import inspect
from typing import Any

from hydra.utils import get_class
from omegaconf import OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import Compose, Transform

from torchgrasp.config.lenses import describe_lens
from torchgrasp.config.parts import build
from torchgrasp.config.trained_policy import TrainedPolicy
from torchgrasp.errors import ConfigError
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.transforms import DepthToPoints, PointTransform, TablePlane


class TrainedView:
    """From one step's observations [1] to what the policy reads; it remembers an episode.

    Args:
        transforms: the policy's own, in their order.
        wanted: keys that the policy reads.
    """

    def __init__(self, transforms: list[Transform], wanted: list) -> None:
        self._transforms, self._wanted = transforms, wanted
        self._chain = Compose(*transforms)  # pyright: ignore[reportArgumentType] (TorchRL's hint)

    def look(self, observed: TensorDictBase, *, begins: bool) -> TensorDictBase:
        """What the policy reads of this step; the first of an episode where it `begins`."""
        self._check(observed)
        # As an environment calls them at its reset, and at its steps.
        if begins:
            return self._chain._reset(observed.empty(), observed)
        return self._chain._step(observed.empty(), observed)

    def _check(self, observed: TensorDictBase) -> None:
        there = set(observed.keys(True, True))
        for transform in self._transforms:
            for key in transform.in_keys:
                if key not in there:
                    raise ConfigError(f"The policy needs {_told(key)}, which was not given.")
            there.update(transform.out_keys)
        if missing := [key for key in self._wanted if key not in there]:
            raise ConfigError(f"The policy needs {_told(missing[0])}, which was not given.")


def _told(key: Any) -> str:
    name = ".".join(key) if isinstance(key, tuple) else key
    return f"{name} (no camera of the arm's hand shows it)" if key[0] == "overhead" else name


def training_lens(policy: TrainedPolicy) -> CameraIntrinsics:
    """The intrinsics of the wrist camera that a policy was trained with."""
    theirs = policy.config["camera"].get("intrinsics") or {}
    return CameraIntrinsics(**{name: value for name, value in theirs.items() if name != "_target_"})


def check_action_space(policy: TrainedPolicy) -> None:
    """Refuse a policy whose actions are no poses of the hand.

    Raises:
        ConfigError: where it was trained with `joint_delta` or `joint_velocity`.
    """
    name = policy.config["env"].get("action_space", "ee_delta")
    if name != "ee_delta":
        raise ConfigError(
            f"policy was trained with action_space={name}, which moves a Panda's joints and tells no hand "
            "pose: give one of action_space=ee_delta."
        )


def choose_transforms(policy: TrainedPolicy) -> list[tuple[type, dict[str, Any]]]:
    """Class and configuration of each transform that makes what a policy reads, in their order.

    Left out are those that make a simulated sensor err, and those whose results nothing reads.
    """
    nodes = [(get_class(node["_target_"]), dict(node)) for node in policy.config["transforms"].values()]
    wanted, kept = set(policy.in_keys), []
    for made, node in reversed(nodes):
        if issubclass(made, PointTransform) and made.simulates_sensor:
            continue
        transform = build(OmegaConf.create(node))
        if transform.out_keys and wanted.isdisjoint(transform.out_keys):
            continue
        wanted.update(transform.in_keys)
        kept.append((made, node))
    return kept[::-1]


def make_view(
    policy: TrainedPolicy, *, intrinsics: CameraIntrinsics | None, table_height: float
) -> TrainedView:
    """The view of a policy: its transforms, as far as they make what it reads (see `choose_transforms`).

    Args:
        policy: of `load_policy`.
        intrinsics: of the camera whose pictures it is shown; None for clouds in the hand's frame.
        table_height: of the table above the base's origin, metres.
    """
    lens = None if intrinsics is None else describe_lens(intrinsics)
    kept = []
    for made, options in choose_transforms(policy):
        if lens is None and issubclass(made, DepthToPoints):
            continue
        takes = inspect.signature(made).parameters
        if "intrinsics" in takes:
            options.pop("fov", None)
            options["intrinsics"] = lens
        if lens is None and "carve" in takes:
            options["carve"] = None  # no picture shows what is looked through
        if issubclass(made, TablePlane):
            options["height"] = table_height
        kept.append(build(OmegaConf.create(options)))
    return TrainedView(kept, list(policy.in_keys))
