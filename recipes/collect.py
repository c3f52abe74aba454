"""Demonstrations: the expert grasps, disturbed now and then, until there are enough successful steps.

python recipes/collect.py demonstrations.steps=50000 demonstrations.path=demos
"""

from __future__ import annotations

from itertools import count
from pathlib import Path

import common
import hydra
from hydra.utils import instantiate
from omegaconf import DictConfig
from tensordict.nn import TensorDictSequential

from torchgrasp.data import append_shard, count_shards, open_demonstrations
from torchgrasp.planning import ExpertPolicy
from torchgrasp.training import EpisodePool, Progress, one_line_errors

# Rounds of all worlds in a file of demonstrations, which is written whole or not at all.
_SHARD_ROUNDS = 4


def collect(cfg: DictConfig, pool: EpisodePool, path: Path) -> dict:
    """Add shards to `path` until its successful episodes have `demonstrations.steps` steps.

    Shard k holds the same episodes whenever it is collected, so a collection that was cut off goes on
    where its last whole shard ended.

    Returns:
        The card of the demonstrations: objects, episodes, successes, bytes.
    """
    done, card = count_shards(path), {}
    if done:
        card = open_demonstrations(path).card
    wanted, have = cfg.demonstrations.steps, card.get("successful_steps", 0)
    progress = Progress(wanted, initial=min(wanted, have), description="demonstrations", unit="step")
    expert = ExpertPolicy(common.make_objects(cfg, "train"), horizon=cfg.env.horizon)
    modules: list = [expert, instantiate(cfg.collector.disturb)]
    policy = TensorDictSequential(*modules)
    for shard in count(done):
        if have >= wanted:
            break
        rounds = range(shard * _SHARD_ROUNDS, (shard + 1) * _SHARD_ROUNDS)
        episodes = [episode for batch in pool.run("train", policy, rounds) for episode in batch]
        card = append_shard(
            path,
            [episode.steps for episode in episodes],
            objects=[episode.object_name for episode in episodes],
            seeds=[cfg.seed] * len(episodes),
            index=shard,
        )
        progress.update(
            min(wanted, card["successful_steps"]) - min(wanted, have),
            success_rate=card["successes"] / card["episodes"],
        )
        have = card["successful_steps"]
    progress.close()
    return card


@hydra.main(version_base=None, config_path="../conf", config_name="td3_bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Collect into `demonstrations.path`, by default outputs/demonstrations."""
    path = Path(cfg.demonstrations.path or Path(cfg.output_dir) / "demonstrations")
    with common.make_pool(cfg) as pool:
        common.prepare_objects(cfg)
        card = collect(cfg, pool, path)
    print(
        f"{path}: {card['episodes']} episodes, {card['successes']} successful, {card['bytes'] / 1e6:.0f} MB"
    )


if __name__ == "__main__":
    main()
