"""Objects, environments, the expert, and who runs episodes, as configured."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from omegaconf import DictConfig, OmegaConf
from torchrl.envs import Compose, TransformedEnv

from torchgrasp import keys
from torchgrasp.config.parts import at_place, build
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.geometry import ACTION_SIZE
from torchgrasp.objects import ObjectSet
from torchgrasp.planning import ExpertPolicy
from torchgrasp.rollouts import EpisodePool, SerialPool
from torchgrasp.sim import make_engine, prepare_resting
from torchgrasp.sim.control import ActionSpace, make_action_space

# What a learner needs of a step; the camera's pictures stay where they were made.
LEARNED_FROM = (
    *(keys.POINTS, keys.IMAGE, keys.TABLE_PLANE, keys.T_BASE_EE, keys.TIME_LEFT, keys.ACTION),
    *(keys.EXPERT_ACTION, keys.HAS_EXPERT, keys.GOAL, keys.HAS_GOAL),
    *(keys.PERTURBED, keys.EPISODE, keys.WORLD, keys.TURN),
    *(keys.TRIED_ACTION, keys.TRIED_REWARD),
)


def make_objects(cfg: DictConfig, split: str) -> ObjectSet:
    """The training objects as configured, or for "test" those of the evaluation, where there are splits."""
    objects: Any = cfg.objects
    if split == "test" and objects.get("split") is not None:
        chosen = {name: cfg.evaluation[name] for name in ("split", "num_objects") if name in objects}
        objects = OmegaConf.merge(objects, chosen)
    return build(_into_members(objects) if "sets" in objects else objects)


def _into_members(objects: DictConfig) -> DictConfig:
    """A mixture's configuration with its own split, num_objects and num_grasps written into its sets.

    A set that trains on a split of another name (YCB's `others`) keeps it when the mixture says `train`.
    """
    objects = deepcopy(objects)
    OmegaConf.set_struct(objects, False)
    for name in ("split", "num_objects", "num_grasps"):
        value = objects.pop(name, None)
        for member in objects.sets.values():
            own = name == "split" and value == "train" and member.get(name) is not None
            if name in member and value is not None and not own:
                member[name] = value
    return objects


def make_split_env(cfg: DictConfig, split: str) -> TransformedEnv:
    """The environment of training or evaluation with the transforms of the configuration."""
    options = {"seed": cfg.seed}
    if split == "test":
        options = {"seed": cfg.evaluation.seed, "num_envs": cfg.evaluation.num_envs}
        if (motion := cfg.evaluation.get("target_motion")) is not None:
            options["target_motion"] = motion
    cameras = {"camera": build(cfg.camera), "overhead": build(cfg.overhead)}
    env: GraspEnv = build(cfg.env, objects=make_objects(cfg, split), **cameras, **options, **_engine(cfg))
    return TransformedEnv(env, make_transforms(cfg.transforms))


@dataclass(frozen=True)
class SplitEnv:
    """`make_split_env` for a pool, on whichever machine: see `rollouts.machines.Portable`."""

    cfg: DictConfig
    split: str

    def __call__(self) -> TransformedEnv:
        """The environment."""
        return make_split_env(self.cfg, self.split)

    def ingredients(self) -> dict[str, str]:
        """The objects by name, with what decides each."""
        return make_objects(self.cfg, self.split).contents()

    def obstacle(self) -> str | None:
        """What is not as the configuration needs it on this machine; raises where a part cannot be built."""
        make_transforms(self.cfg.transforms)
        for part in (self.cfg.camera, self.cfg.overhead):
            build(part)
        _engine(self.cfg)
        return make_objects(self.cfg, self.split).obstacle()


def _engine(cfg: DictConfig) -> dict[str, DictConfig]:
    """The engine as an option of the environment; none for runs of before there were two."""
    if cfg.get("engine") is None:
        return {}
    make_engine(build(cfg.engine))  # what is wrong with it is told with its own place
    return {"engine": cfg.engine}


def make_transforms(transforms: DictConfig) -> Compose:
    """The ordered mapping of names to transforms as one chain."""
    return Compose(*(build(each) for each in transforms.values()))


def observed_shapes(cfg: DictConfig) -> dict[Any, tuple[int, ...]]:
    """Shape of each observation in one world; raises where no environment can be built."""
    if "model" in cfg and make_actions(cfg).size != ACTION_SIZE:
        raise ConfigError(
            f"env.action_space={cfg.env.action_space}: the networks of conf/model write relative hand poses;"
            " train with ee_delta, or give a network of your own to an environment of your own."
        )
    spec = make_split_env(cfg, "test").observation_spec
    worlds = len(spec.shape)
    return {key: tuple(spec[key].shape[worlds:]) for key in spec.keys(True, True)}


def make_pool(cfg: DictConfig, *, keep: Iterable = LEARNED_FROM) -> EpisodePool:
    """Who runs episodes of "train" and "test", as configured; it hands over `keep` and the states stored."""
    resolved: DictConfig = deepcopy(cfg)
    OmegaConf.resolve(resolved)
    envs = {split: SplitEnv(resolved, split) for split in ("train", "test")}
    workers = cfg.collector.num_workers
    make: Callable[..., EpisodePool] = build(resolved.collector.pool, _partial_=True)
    stored = build(cfg.replay.codec).observation_keys if "replay" in cfg else ()
    with at_place("collector"):
        return (make if workers else SerialPool)(envs, num_workers=workers, keep=(*keep, *stored))


def prepare_objects(cfg: DictConfig, *splits: str) -> None:
    """Build and settle what is not cached yet, on every core; the objects of both splits by default."""
    for split in splits or ("train", "test"):
        workers = None if cfg.collector.num_workers else 1  # every core, unless one process shall do
        objects = make_objects(cfg, split)
        prepare_resting(objects, build(cfg.env.physics), workers=workers)
        for index in range(len(objects)):
            if (reason := objects.refusal(index)) is not None:
                raise ObjectError(f"{objects.names[index]} cannot be used: {reason}")


def make_actions(cfg: DictConfig) -> ActionSpace:
    """What an action means in the environment of the configuration."""
    with at_place("env"):
        return make_action_space(cfg.env.action_space, control_period=build(cfg.env.physics).control_period)


def make_expert(cfg: DictConfig, split: str, *, execute: bool = True) -> ExpertPolicy:
    """The expert for the objects of a split."""
    return build(
        cfg.expert,
        make_objects(cfg, split),
        horizon=cfg.env.horizon,
        action_space=make_actions(cfg),
        execute=execute,
    )
