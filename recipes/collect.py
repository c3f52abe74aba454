"""Demonstrations: episodes of one kind, until enough of the steps are there that the kind is for.

python recipes/collect.py demonstrations.steps=50000 demonstrations.path=demos
python recipes/collect.py demonstrations.kind=failed demonstrations.path=failures
python recipes/collect.py demonstrations.kind=learner demonstrations.policy=<run dir>
"""

from __future__ import annotations

import time
from collections.abc import Generator
from itertools import count
from pathlib import Path

import common
import hydra
import policies
import settings
from behaviour import DISTURBANCE
from hydra.utils import instantiate
from networks import make_row
from omegaconf import DictConfig
from origin import SHARD_ROUNDS, check_learner, check_origin, describe_origin, take_given
from sources import Source, list_demonstrations
from tensordict.nn import TensorDictSequential

from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.data import append_shard, begin_demonstrations, count_shards, open_demonstrations
from torchgrasp.data.demonstration_kinds import COUNTED, resolve_count
from torchgrasp.errors import ConfigError
from torchgrasp.rollouts.episode_pool import Episode, EpisodePool
from torchgrasp.runs.progress import Progress

# Episodes without one of the kind wanted after which collecting would never end.
_HOPELESS = 200


def collect(cfg: DictConfig, pool: EpisodePool, path: Path) -> dict:
    """Add shards to `path` until `demonstrations.steps` steps are there that count.

    Shard k holds the same episodes whenever it is collected, so a collection that was cut off goes on
    where its last whole shard ended.

    Returns:
        The card of the demonstrations.
    """
    demos, origin = cfg.demonstrations, describe_origin(cfg)
    counted = COUNTED[resolve_count(demos.count, demos.kind)]
    card = begin_demonstrations(path, kind=demos.kind, provenance=origin)
    check_origin(origin, path, card)
    if done := count_shards(path):
        card = open_demonstrations(path).card
    progress = Progress(
        demos.steps, initial=min(demos.steps, card[counted]), description=f"{demos.kind} steps", unit="step"
    )
    shards = _run_shards(cfg, pool, done)
    while card[counted] < demos.steps:
        before, started = card[counted], time.monotonic()
        index, episodes = next(shards)
        kept = [each for each in episodes if demos.kind != "failed" or not each.success]
        card = append_shard(
            path,
            [each.steps for each in kept],
            objects=[each.object_name for each in kept],
            seeds=[cfg.seed] * len(kept),
            index=index,
            attempts=len(episodes),
            codec=instantiate(cfg.replay.codec),
            wall_seconds=time.monotonic() - started,
        )
        progress.update(
            min(demos.steps, card[counted]) - min(demos.steps, before),
            success_rate=1.0 - _count_failures(card) / card["attempts"],
        )
        _check_hope(cfg, card, card[counted])
    shards.close()
    progress.close()
    return card


def _count_failures(card: dict) -> int:
    """Failed episodes among all that were run; of the kind failed, they alone were kept."""
    return card["episodes"] if card["kind"] == "failed" else card["episodes"] - card["successes"]


def _run_shards(cfg: DictConfig, pool: EpisodePool, first: int) -> Generator[tuple[int, list[Episode]]]:
    """Each shard's number and episodes from shard `first` on, enough shards at once for all workers."""
    policy = make_collector(cfg)
    at_once = max(1, -(-cfg.collector.num_workers // SHARD_ROUNDS))
    for start in count(first, at_once):
        numbers = range(start * SHARD_ROUNDS, (start + at_once) * SHARD_ROUNDS)
        batches = pool.run("train", policy, numbers)
        for index in range(start, start + at_once):
            yield index, [episode for _ in range(SHARD_ROUNDS) for episode in next(batches)]


def make_collector(cfg: DictConfig) -> TensorDictSequential:
    """Who acts, and labels, in demonstrations of the kind configured."""
    kind = cfg.demonstrations.kind
    if kind == "learner":
        check_learner(cfg)
        learner = common.for_workers(policies.make_policy(cfg, str(cfg.demonstrations.policy)))
        # The label comes last: a goal network writes its prediction where the label's goal belongs.
        modules: list = [learner, common.make_expert(cfg, "train", execute=False)]
        if cfg.demonstrations.expert_start:
            modules.append(instantiate(cfg.collector.expert_start))
        return TensorDictSequential(*modules)
    return make_demonstrator(cfg, kind)


def make_demonstrator(cfg: DictConfig, kind: str) -> TensorDictSequential:
    """The expert as it acts in demonstrations of a kind: disturbed, unless that is `expert`."""
    modules: list = [common.make_expert(cfg, "train")]
    if kind in DISTURBANCE:
        modules.append(instantiate(cfg.collector[DISTURBANCE[kind]]))
    return TensorDictSequential(*modules)


def _check_hope(cfg: DictConfig, card: dict, have: int) -> None:
    if card["attempts"] < _HOPELESS or have:
        return
    if cfg.demonstrations.kind == "failed":
        raise ConfigError(
            f"The expert failed in none of {card['attempts']} episodes: disturb it more, by "
            "collector.disturb_to_fail.probability or its translation and rotation."
        )
    raise ConfigError(
        f"No step of {card['attempts']} episodes counts (env.horizon={cfg.env.horizon}): "
        "give more steps to an episode, or objects that the hand can hold."
    )


def demonstrations(cfg: DictConfig, pool: EpisodePool, run_dir: Path) -> list[Source]:
    """The sources of demonstrations: folders that were given, or below `run_dir`, collected as configured."""
    sources = []
    for name, each in list_demonstrations(cfg).items():
        if each.demonstrations.path is not None:
            sources.append(take_given(each, name))
            continue
        path = run_dir / ("demonstrations" if name == "expert" else f"demonstrations_{name}")
        collect(each, pool, path)
        sources.append(Source.of(each, name, path))
    return sources


@hydra.main(version_base=None, config_path="../conf", config_name="td3_bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Collect into `demonstrations.path`, by default outputs/demonstrations."""
    path = Path(cfg.demonstrations.path or Path(cfg.output_dir) / "demonstrations")
    settings.check_values(cfg)
    make_row(instantiate(cfg.replay.codec), None, common.observed_shapes(cfg))  # refuses what cannot be kept
    with common.make_pool(cfg) as pool:
        common.prepare_objects(cfg, "train")
        card = collect(cfg, pool, path)
    print(
        f"{path}: {card['episodes']} {card['kind']} episodes of {card['attempts']} run, "
        f"{card['successes']} successful, {card['steps']} steps, {card['bytes'] / 1e6:.0f} MB"
    )


if __name__ == "__main__":
    main()
