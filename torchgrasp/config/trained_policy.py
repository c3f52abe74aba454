"""A trained policy as one module, and the environment that it was trained in: `torchgrasp.load_policy`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from omegaconf import OmegaConf
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.envs import TransformedEnv

from torchgrasp.config.environments import make_transforms
from torchgrasp.config.lenses import describe_lens, follow_cameras
from torchgrasp.config.networks import make_mirror, rebuild_acting
from torchgrasp.config.parts import build
from torchgrasp.config.weights_files import check_weights, read_trained
from torchgrasp.envs import GraspEnv, Start, TargetMotion
from torchgrasp.modules.policy import join_policy
from torchgrasp.objects import GraspObject, ProceduralObjects
from torchgrasp.sim import Camera, Engine, EngineName, Physics


class TrainedPolicy(TensorDictSequential):
    """The networks that act, and the configuration that they were trained with.

    In evaluation mode and without gradients: call `requires_grad_()` and `train()` to train it further.

    Reads what the networks read (points, time left, ...) and writes `action` (*, 6), a relative hand pose in
    metres and radians, and `goal_prediction` (*, 7), the grasp in the ee frame.

    Args:
        policy: the networks, joined.
        config: the configuration that they bring along, as plain values.
    """

    def __init__(self, policy: TensorDictModuleBase, *, config: dict[str, Any]) -> None:
        modules: list = [policy]
        super().__init__(*modules)
        self.config = config
        self.eval().requires_grad_(False)

    @property
    def horizon(self) -> int:
        """T, steps of the episodes that it was trained in."""
        return self.config["env"]["horizon"]


def load_policy(
    source: str | Path = "pretrained", *, trust: Iterable[str] = (), device: torch.device | str = "cpu"
) -> TrainedPolicy:
    """The trained policy of a run directory or weights file, or the one that comes with the library.

    Nothing is unpickled. The file is data: it may name classes of torchgrasp and TorchRL where they belong,
    such as a transform among transforms, and no other code.

    Args:
        source: ``pretrained``, a run directory, or a file of `torchgrasp.runs.save_weights`.
        trust: packages besides torchgrasp and torchrl whose classes the file may name.
        device: of the networks.

    Raises:
        ConfigError: where there are no such weights, or they name what they may not.
        CheckpointError: where the file is damaged or tells too little.

    Example:
        >>> import torchgrasp
        >>> policy = torchgrasp.load_policy("pretrained")
        >>> policy.horizon, "points" in policy.in_keys, "action" in policy.out_keys
        (30, True, True)
    """
    check_weights("source", str(source))
    trained = read_trained(Path(source), trust)
    policy = join_policy(rebuild_acting(trained), make_mirror(trained.config["model"]))
    return TrainedPolicy(policy, config=trained.config).to(device)


def make_env(
    policy: TrainedPolicy | str | Path = "pretrained",
    *,
    objects: Sequence[GraspObject] | None = None,
    num_envs: int = 1,
    seed: int | None = None,
    camera: Camera | None = None,
    start: Start | None = None,
    physics: Physics | None = None,
    engine: Engine | EngineName = "sapien",
    target_motion: TargetMotion | Literal["static", "jitter", "handover", "mixed"] = "static",
    object_order: Literal["random", "cycle"] = "random",
) -> TransformedEnv:
    """A GraspEnv with the cameras, transforms, horizon and action space that a policy was trained with.

    Args:
        policy: of `load_policy`, or what that takes.
        objects: what is grasped; by default 80 procedural objects that the pretrained policy never saw.
        num_envs: N; the batch size is [N].
        seed: of all randomness of the scenes; drawn if None.
        camera: on the wrist, in place of that of training; the transforms follow its intrinsics.
        start: where episodes begin; facing the target (Sec. 6.2) by default.
        physics: masses, friction, forces and rates.
        engine: ``sapien``, ``mujoco`` (extra mujoco), or an `Engine`.
        target_motion: ``static``, ``jitter`` (Sec. 6.6), ``handover`` (6.7), ``mixed``, or a motion itself.
        object_order: ``random`` or ``cycle``.

    Example:
        >>> import torchgrasp
        >>> from torchgrasp.objects import ProceduralObjects
        >>> policy = torchgrasp.load_policy("pretrained")
        >>> objects = ProceduralObjects("test", num_objects=1, num_grasps=100)
        >>> env = torchgrasp.make_env(policy, objects=objects, num_envs=2, seed=1)
        >>> steps = env.rollout(env.horizon, policy)
        >>> steps["next", "reward"].sum(dim=(1, 2)).shape
        torch.Size([2])
    """
    config = (policy if isinstance(policy, TrainedPolicy) else load_policy(policy)).config
    brought = follow_cameras(config)
    seen = {name: brought.get(name) for name in ("camera", "overhead", "transforms")}
    if camera is not None:
        seen["camera"] = {"intrinsics": describe_lens(camera.intrinsics)}
    cfg: Any = OmegaConf.create(seen)
    env = GraspEnv(
        num_envs,
        objects=ProceduralObjects("test", num_objects=80) if objects is None else objects,
        camera=build(cfg.camera) if camera is None else camera,
        overhead=build(cfg.overhead),
        horizon=config["env"]["horizon"],
        start=start,
        physics=physics,
        engine=engine,
        target_motion=target_motion,
        action_space=config["env"].get("action_space", "ee_delta"),
        object_order=object_order,
        seed=seed,
    )
    return TransformedEnv(env, make_transforms(cfg.transforms))
