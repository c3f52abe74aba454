"""What the recipes share: components from the configuration, run directories, evaluation."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from torchrl.envs import Compose, TransformedEnv

from torchgrasp import keys
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import CheckpointError, ConfigError, check_range
from torchgrasp.objects import ObjectSet
from torchgrasp.planning import ExpertPolicy, RandomAction
from torchgrasp.training import EpisodePool, Progress, SuccessTable, load_weights, make_run_dir

# What a learner needs of a step; poses and pictures stay where they were made.
KEPT = (
    *(keys.POINTS, keys.TIME_LEFT, keys.ACTION, keys.EXPERT_ACTION, keys.HAS_EXPERT),
    *(keys.GOAL, keys.HAS_GOAL, keys.PERTURBED, keys.EPISODE, keys.WORLD),
)

# Online episodes are numbered from here on: none repeats a demonstration.
ONLINE_EPISODES = 1_000_000


def make_objects(cfg: DictConfig, split: str) -> ObjectSet:
    """The training objects as configured, or those of another split."""
    objects = cfg.objects
    if split == "test" and objects.get("split") is not None:
        chosen = {name: cfg.evaluation[name] for name in ("split", "num_objects") if name in objects}
        objects = OmegaConf.merge(objects, chosen)
    return instantiate(objects)


def make_env(cfg: DictConfig, split: str) -> TransformedEnv:
    """The environment of training or evaluation with the transforms of the configuration."""
    seed = cfg.seed if split == "train" else cfg.evaluation.seed
    camera = instantiate(cfg.camera)
    env: GraspEnv = instantiate(cfg.env, objects=make_objects(cfg, split), camera=camera, seed=seed)
    return TransformedEnv(env, Compose(*(instantiate(each) for each in cfg.transforms.values())))


def check_config(cfg: DictConfig) -> None:
    """Build the environments once, so that a value that cannot be is refused before anything is written."""
    for split in ("train", "test"):
        make_env(cfg, split).close()


def make_pool(cfg: DictConfig) -> EpisodePool:
    """Workers that run episodes of "train" and "test"."""
    OmegaConf.resolve(cfg)
    envs = {split: functools.partial(make_env, cfg, split) for split in ("train", "test")}
    return EpisodePool(envs, num_workers=cfg.collector.num_workers, keep=KEPT)


def prepare_objects(cfg: DictConfig, *splits: str) -> None:
    """Build what is not cached yet, with a progress bar; the objects of both splits by default."""
    for split in splits or ("train", "test"):
        make_objects(cfg, split).prepare(workers=max(1, cfg.collector.num_workers))


def make_policy(cfg: DictConfig, name: str) -> Callable:
    """The policy `name`: expert, random, or a run directory or weights file."""
    if name == "expert":
        return ExpertPolicy(make_objects(cfg, "test"), horizon=cfg.env.horizon)
    if name == "random":
        return RandomAction(seed=cfg.evaluation.seed)
    path = Path(name)
    if not path.exists():
        raise ConfigError(f"policy={name!r}: give expert, random, a run directory or a weights file.")
    states, config = load_weights(_weights_file(path))
    actor = instantiate(OmegaConf.create(config["model"]).actor)
    try:
        actor.load_state_dict(states["actor"])
    except (KeyError, RuntimeError) as error:
        raise CheckpointError(
            f"The weights of {path} do not fit the network they describe: {error}"
        ) from error
    return actor.eval()


def _weights_file(path: Path) -> Path:
    return path / "weights.safetensors" if path.is_dir() else path


def evaluate(cfg: DictConfig, pool: EpisodePool, policy: Callable, description: str) -> SuccessTable:
    """Success of a policy on the first `evaluation.episodes` scenes of the evaluation split."""
    table, wanted = SuccessTable(), cfg.evaluation.episodes
    progress = Progress(wanted, description=description, unit="episode")
    numbers = range(-(-wanted // cfg.env.num_envs))
    for batch in pool.run("test", policy, numbers):
        for episode in batch[: wanted - table.episodes]:
            table.add(episode.object_name, episode.success)
            progress.update(success_rate=table.success_rate)
    progress.close()
    return table


def resumed_config(cfg: DictConfig) -> DictConfig:
    """The configuration itself, or with `resume` that of the run resumed, changed by what was given."""
    if cfg.resume is None:
        return cfg
    stored = Path(cfg.resume) / "config.yaml"
    if not stored.is_file():
        raise CheckpointError(
            f"resume={cfg.resume} is no run directory (no config.yaml in it): give one of {cfg.output_dir}/."
        )
    hydra = HydraConfig.get() if HydraConfig.initialized() else None
    given = [each for each in (hydra.overrides.task if hydra else []) if not each.startswith("resume=")]
    groups = set(hydra.runtime.choices) if hydra else set()
    fixed = [each for each in given if each[0] in "~+" or each.split("=")[0] in groups]
    if fixed:
        raise ConfigError(f"resume={cfg.resume} with {fixed}: only plain values can be changed on the way.")
    merged: Any = OmegaConf.merge(
        OmegaConf.load(stored), OmegaConf.from_dotlist(given), {"resume": cfg.resume}
    )
    return merged


def open_run(cfg: DictConfig, recipe: str) -> Path:
    """The directory of the run that `resume` names, or a new one with the configuration in it."""
    if cfg.resume is not None:
        return Path(cfg.resume)
    run_dir = make_run_dir(recipe, root=cfg.output_dir)
    OmegaConf.save(cfg, run_dir / "config.yaml", resolve=True)
    return run_dir


def evaluation_config(cfg: DictConfig) -> DictConfig:
    """The configuration of an evaluation: what a trained policy brings along, then what was given."""
    if cfg.protocol != "static":
        raise ConfigError(f"protocol={cfg.protocol!r} is unknown: give static.")
    check_range("episodes", cfg.episodes, 1, float("inf"))
    path = Path(str(cfg.policy))
    merged: Any = OmegaConf.create(OmegaConf.to_container(cfg))
    if path.exists():
        brought = load_weights(_weights_file(path))[1]
        given = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
        kept = {name: brought[name] for name in ("model", "camera", "transforms")}
        merged = OmegaConf.merge(
            {key: value for key, value in cfg.items() if key not in kept},
            {**kept, "env": {"horizon": brought["env"]["horizon"]}},
            OmegaConf.from_dotlist([each for each in given if "." in each.split("=")[0]]),
        )
    merged.evaluation = {
        "episodes": cfg.episodes,
        "seed": cfg.seed,
        "split": cfg.objects.get("split"),
        "num_objects": cfg.objects.get("num_objects"),
    }
    return merged


def print_comparison(cfg: DictConfig, tables: dict[str, dict]) -> None:
    """Success rates side by side, the policy's last."""
    where = f"{cfg.evaluation.episodes} scenes of the {cfg.evaluation.split} split"
    print(f"\nSuccess on the same {where} (95 % interval)")
    for name, table in reversed(tables.items()):
        low, high = (100 * bound for bound in table["success_ci95"])
        print(f"  {name:30s} {100 * table['success_rate']:5.1f} %  [{low:.1f}, {high:.1f}]")
