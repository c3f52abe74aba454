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
from torchgrasp.errors import CheckpointError, ConfigError
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
    if split == "train" or cfg.objects.get("split") is None:
        return instantiate(cfg.objects)
    options = {"num_objects": cfg.evaluation.num_objects} if "num_objects" in cfg.objects else {}
    return instantiate(cfg.objects, split=cfg.evaluation.split, **options)


def make_env(cfg: DictConfig, split: str) -> TransformedEnv:
    """The environment of training or evaluation with the transforms of the configuration."""
    seed = cfg.seed if split == "train" else cfg.evaluation.seed
    camera = instantiate(cfg.camera)
    env: GraspEnv = instantiate(cfg.env, objects=make_objects(cfg, split), camera=camera, seed=seed)
    return TransformedEnv(env, Compose(*(instantiate(each) for each in cfg.transforms.values())))


def make_pool(cfg: DictConfig) -> EpisodePool:
    """Workers that run episodes of "train" and "test"."""
    OmegaConf.resolve(cfg)
    envs = {split: functools.partial(make_env, cfg, split) for split in ("train", "test")}
    return EpisodePool(envs, num_workers=cfg.collector.num_workers, keep=KEPT)


def prepare_objects(cfg: DictConfig) -> None:
    """Build what is not cached yet, with a progress bar."""
    for split in ("train", "test"):
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
    states, config = load_weights(path / "weights.safetensors" if path.is_dir() else path)
    actor = instantiate(OmegaConf.create(config["model"]).actor)
    try:
        actor.load_state_dict(states["actor"])
    except (KeyError, RuntimeError) as error:
        raise CheckpointError(
            f"The weights of {path} do not fit the network they describe: {error}"
        ) from error
    return actor.eval()


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


def open_run(cfg: DictConfig, recipe: str) -> tuple[DictConfig, Path]:
    """The configuration and directory of a new run, or of the one that `resume` names."""
    if cfg.resume is None:
        run_dir = make_run_dir(recipe, root=cfg.output_dir)
        OmegaConf.save(cfg, run_dir / "config.yaml", resolve=True)
        return cfg, run_dir
    run_dir = Path(cfg.resume)
    if not (run_dir / "config.yaml").is_file():
        raise CheckpointError(
            f"resume={run_dir} is no run directory (it has no config.yaml): give one of outputs/{recipe}/."
        )
    stored = OmegaConf.load(run_dir / "config.yaml")
    given = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    changes = [each for each in given if not each.startswith("resume=")]
    if any(each[0] in "~+" or each.split("=")[0] in cfg.get("groups", ()) for each in changes):
        raise ConfigError(f"resume={run_dir} with {changes}: only plain values can be changed on the way.")
    merged: Any = OmegaConf.merge(stored, OmegaConf.from_dotlist(changes))
    return merged, run_dir


def print_comparison(cfg: DictConfig, tables: dict[str, dict], run_dir: Path) -> None:
    """Success rates side by side, the policy's last."""
    where = f"{cfg.evaluation.episodes} scenes of the {cfg.evaluation.split} split"
    print(f"\nSuccess on the same {where} (95 % interval)")
    for name, table in reversed(tables.items()):
        low, high = (100 * bound for bound in table["success_ci95"])
        print(f"  {name:30s} {100 * table['success_rate']:5.1f} %  [{low:.1f}, {high:.1f}]")
    print(f"Written to {run_dir}: summary.json, metrics.csv, weights.safetensors")
