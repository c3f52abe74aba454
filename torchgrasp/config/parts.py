"""What the recipes share: components from the configuration, policies, evaluation."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Generator, Iterable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from schedule import count_rounds
from torch import nn
from torchrl.envs import Compose, TransformedEnv

from torchgrasp import keys
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.geometry import ACTION_SIZE
from torchgrasp.objects import ObjectSet
from torchgrasp.planning import ExpertPolicy
from torchgrasp.report.film import EndingRecorder, EpisodeFilm, write_video
from torchgrasp.rollouts.episode_pool import Episode, EpisodePool, SerialPool
from torchgrasp.rollouts.rounds import collect_rounds
from torchgrasp.runs.progress import Progress
from torchgrasp.sim import prepare_resting
from torchgrasp.sim.control import ActionSpace, make_action_space

# What a learner needs of a step; the camera's pictures stay where they were made.
KEPT = (
    *(keys.POINTS, keys.IMAGE, keys.TABLE_PLANE, keys.T_BASE_EE, keys.TIME_LEFT, keys.ACTION),
    *(keys.EXPERT_ACTION, keys.HAS_EXPERT, keys.GOAL, keys.HAS_GOAL),
    *(keys.PERTURBED, keys.EPISODE, keys.WORLD, keys.TURN),
)
# Online episodes are numbered from here on: none repeats a demonstration.
ONLINE_EPISODES = 1_000_000


def make_objects(cfg: DictConfig, split: str) -> ObjectSet:
    """The training objects as configured, or for "test" those of the evaluation, where there are splits."""
    objects: Any = cfg.objects
    if split == "test" and objects.get("split") is not None:
        chosen = {name: cfg.evaluation[name] for name in ("split", "num_objects") if name in objects}
        objects = OmegaConf.merge(objects, chosen)
    return instantiate(_into_members(objects) if "sets" in objects else objects)


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


def make_env(cfg: DictConfig, split: str) -> TransformedEnv:
    """The environment of training or evaluation with the transforms of the configuration."""
    options = {"seed": cfg.seed}
    if split == "test":
        options = {"seed": cfg.evaluation.seed, "num_envs": cfg.evaluation.num_envs}
        if (motion := cfg.evaluation.get("target_motion")) is not None:
            options["target_motion"] = motion
    cameras = {"camera": instantiate(cfg.camera), "overhead": instantiate(cfg.overhead)}
    env: GraspEnv = instantiate(cfg.env, objects=make_objects(cfg, split), **cameras, **options)
    return TransformedEnv(env, Compose(*(instantiate(each) for each in cfg.transforms.values())))


def observed_shapes(cfg: DictConfig) -> dict[Any, tuple[int, ...]]:
    """Shape of each observation in one world; raises where no environment can be built."""
    if "model" in cfg and make_actions(cfg).size != ACTION_SIZE:
        raise ConfigError(
            f"env.action_space={cfg.env.action_space}: the networks of conf/model write relative hand poses;"
            " train with ee_delta, or give a network of your own to an environment of your own."
        )
    spec = make_env(cfg, "test").observation_spec
    worlds = len(spec.shape)
    return {key: tuple(spec[key].shape[worlds:]) for key in spec.keys(True, True)}


def make_pool(cfg: DictConfig, *, keep: Iterable = KEPT) -> EpisodePool:
    """Who runs episodes of "train" and "test", as configured; it hands over `keep` and the states stored."""
    resolved: DictConfig = deepcopy(cfg)
    OmegaConf.resolve(resolved)
    envs = {split: functools.partial(make_env, resolved, split) for split in ("train", "test")}
    workers = cfg.collector.num_workers
    make: Callable[..., EpisodePool] = instantiate(resolved.collector.pool, _partial_=True)
    stored = instantiate(cfg.replay.codec).observation_keys if "replay" in cfg else ()
    return (make if workers else SerialPool)(envs, num_workers=workers, keep=(*keep, *stored))


def rounds(
    cfg: DictConfig, pool: EpisodePool, *policies: Callable, first: int
) -> Generator[list[Episode], None, None]:
    """Rounds of `collector.episodes` training episodes from number `first` on, by the policies in turn."""
    length = count_rounds(cfg)
    return collect_rounds(
        pool,
        "train",
        lambda number: for_workers(policies[(number - ONLINE_EPISODES) // length % len(policies)]),
        first=ONLINE_EPISODES + first * length,
        length=length,
        overlap=cfg.collector.overlap,
    )


def prepare_objects(cfg: DictConfig, *splits: str) -> None:
    """Build and settle what is not cached yet, with a progress bar; the objects of both splits by default."""
    for split in splits or ("train", "test"):
        workers = max(1, min(cfg.collector.num_workers, os.cpu_count() or 1))  # Ray's may be elsewhere
        objects = make_objects(cfg, split)
        prepare_resting(objects, instantiate(cfg.env.physics), workers=workers)
        for index in range(len(objects)):
            if (reason := objects.refusal(index)) is not None:
                raise ObjectError(f"{objects.names[index]} cannot be used: {reason}")


def make_actions(cfg: DictConfig) -> ActionSpace:
    """What an action means in the environment of the configuration."""
    return make_action_space(cfg.env.action_space, control_period=instantiate(cfg.env.physics).control_period)


def make_expert(cfg: DictConfig, split: str, *, execute: bool = True) -> ExpertPolicy:
    """The expert for the objects of a split."""
    return instantiate(
        cfg.expert,
        make_objects(cfg, split),
        horizon=cfg.env.horizon,
        action_space=make_actions(cfg),
        execute=execute,
    )


def for_workers(policy: Callable) -> Callable:
    """A copy of the policy for environments, which run on the CPU, in evaluation mode."""
    return deepcopy(policy).to("cpu").eval() if isinstance(policy, nn.Module) else policy


def evaluate(
    cfg: DictConfig,
    pool: EpisodePool,
    policy: Callable,
    description: str,
    *,
    by: Mapping[str, Callable[[Episode], str]] | None = None,
    watch: Callable[[Episode], None] | None = None,
) -> dict:
    """Success of a policy on the first `evaluation.episodes` scenes, and the steps that it took.

    Each entry of `by` names the group that an episode belongs to, and adds a table of the groups. `watch` is
    shown every episode that counts.
    """
    table, wanted, num_steps = SuccessTable(), cfg.evaluation.episodes, 0
    groups = {name: SuccessTable() for name in by or {}}
    progress = Progress(wanted, description=description, unit="episode")
    numbers = range(-(-wanted // cfg.evaluation.num_envs))
    for batch in pool.run("test", for_workers(policy), numbers):
        for episode in batch[: wanted - table.episodes]:
            table.add(episode.object_name, episode.success, cause=episode.failure)
            for name, group in (by or {}).items():
                groups[name].add(group(episode), episode.success, cause=episode.failure)
            if watch is not None:
                watch(episode)
            num_steps += len(episode.steps)
            progress.update(success_rate=table.success_rate)
    progress.close()
    rows = {name: each.rows() for name, each in groups.items()}
    return {**table.summary(), **rows, "env_steps": num_steps}


def record_videos(cfg: DictConfig, policy: Callable, folder: Path) -> list[Path]:
    """Write the first `video.episodes` episodes of the evaluation as mp4 files.

    They are run once more, in this process: an episode is the same in every process, and the others
    need not hand over pictures and poses.
    """
    env = make_env(cfg, "test")
    base = env.base_env
    assert isinstance(base, GraspEnv)
    fov = base.cameras["camera"].intrinsics.fov
    recorder, film = EndingRecorder(base), EpisodeFilm(base.objects, fov=fov)
    wanted, paths = min(cfg.video.episodes, cfg.evaluation.episodes), []
    progress = Progress(wanted, description="videos", unit="video")
    with SerialPool({"test": lambda: env}) as pool:
        for batch in pool.run("test", for_workers(policy), range(-(-wanted // cfg.evaluation.num_envs))):
            for row, episode in enumerate(batch[: wanted - len(paths)]):
                word = "lifted" if episode.success else "failed"
                path = folder / f"{len(paths):03d}_{episode.object_name.replace('/', '_')}_{word}.mp4"
                frames = film.frames(episode.steps, recorder.endings.pop(row, ()))
                paths.append(write_video(path, frames, fps=cfg.video.fps))
                progress.update()
    progress.close()
    return paths
