"""Demonstrations as configured: collected, or taken from the folders that are given."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig
from tensordict.nn import TensorDictSequential

from torchgrasp.config.demonstration_sources import list_read, make_source
from torchgrasp.config.environments import make_expert
from torchgrasp.config.exploration import make_demonstrator
from torchgrasp.config.parts import at_place, build
from torchgrasp.config.policies import make_policy
from torchgrasp.config.provenance import (
    check_learner,
    check_same_collection,
    check_usable,
    describe_provenance,
)
from torchgrasp.data import begin_demonstrations, count_shards, open_demonstrations
from torchgrasp.data.demonstration_kinds import COUNTED, resolve_count
from torchgrasp.data.demonstration_sources import DemonstrationSource
from torchgrasp.errors import ConfigError
from torchgrasp.rollouts import EpisodePool
from torchgrasp.rollouts.collection import collect_demonstrations
from torchgrasp.rollouts.episode_pool import copy_for_rollouts


def collect(cfg: DictConfig, pool: EpisodePool, path: Path) -> dict:
    """Add shards to the folder `path` until `demonstrations.steps` steps are there that count; its card.

    A collection that was cut off goes on where its last whole shard ended.
    """
    demos, provenance = cfg.demonstrations, describe_provenance(cfg)
    with at_place("demonstrations"):
        card = begin_demonstrations(path, kind=demos.kind, provenance=provenance)
    check_same_collection(provenance, path, card)
    return collect_demonstrations(
        pool,
        make_collecting_policy(cfg),
        path,
        kind=demos.kind,
        count=demos.count,
        num_steps=demos.steps,
        codec=build(cfg.replay.codec),
        seed=cfg.seed,
        provenance=provenance,
        num_workers=cfg.collector.num_workers,
    )


def make_collecting_policy(cfg: DictConfig) -> TensorDictSequential:
    """Who acts, and labels, in demonstrations of the kind configured."""
    kind = cfg.demonstrations.kind
    if kind != "learner":
        return make_demonstrator(cfg, kind)
    check_learner(cfg)
    learner = copy_for_rollouts(make_policy(cfg, str(cfg.demonstrations.policy)))
    # The label comes last: a goal network writes its prediction where the label's goal belongs.
    modules: list = [learner, make_expert(cfg, "train", execute=False)]
    if cfg.demonstrations.expert_start:
        modules.append(build(cfg.collector.expert_start))
    return TensorDictSequential(*modules)


def gather_sources(cfg: DictConfig, pool: EpisodePool, run_dir: Path) -> list[DemonstrationSource]:
    """The sources of demonstrations: folders that were given, or below `run_dir`, collected as configured."""
    sources = []
    for name, each in list_read(cfg).items():
        if each.demonstrations.path is not None:
            sources.append(take_given(each, name))
            continue
        path = run_dir / ("demonstrations" if name == "expert" else f"demonstrations_{name}")
        collect(each, pool, path)
        sources.append(make_source(each, name, path))
    return sources


def given_sources(cfg: DictConfig) -> list[DemonstrationSource]:
    """The sources of demonstrations where nothing is collected: all of them must be given."""
    return [take_given(each, name) for name, each in list_read(cfg).items()]


def take_given(cfg: DictConfig, name: str) -> DemonstrationSource:
    """The source `name` in the folder `demonstrations.path`, which fits the configuration.

    Only further demonstrations may lack a path here, where nothing is collected.
    """
    if cfg.demonstrations.path is None:
        raise ConfigError(
            f"demonstrations.more.{name} has no path, and {cfg.recipe} collects nothing: collect "
            f"it by `torchgrasp collect` first, and give {name} that folder as its path."
        )
    path = Path(str(cfg.demonstrations.path))
    if not count_shards(path):
        raise ConfigError(
            f"demonstrations.path={path} holds none: collect them by `torchgrasp collect` first, or give the "
            "folder that they were moved to."
        )
    with at_place("demonstrations"):
        card = begin_demonstrations(path, kind=cfg.demonstrations.kind)
    check_usable(describe_provenance(cfg), path, card)
    _check_enough(cfg, path)
    return make_source(cfg, name, path)


def _check_enough(cfg: DictConfig, path: Path) -> None:
    """Say it where fewer steps count than were asked for; refuse demonstrations of which none counts."""
    demos, card = cfg.demonstrations, open_demonstrations(path, verify=False).card
    count = resolve_count(demos.count, demos.kind)
    have = card[COUNTED[count]]
    if not have:
        raise ConfigError(
            f"Of {card['steps']} steps in {path}, none are of {count} episodes: give another "
            "demonstrations.count, or other demonstrations."
        )
    if have < demos.steps:
        print(
            f"{path} holds {have} steps that count ({count} episodes), demonstrations.steps={demos.steps} "
            "asks for more: training goes on with them. If they are being collected, stop, and finish that "
            f"by `torchgrasp collect` with the same options first; else give demonstrations.steps={have}."
        )
