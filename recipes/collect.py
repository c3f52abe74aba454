"""Demonstrations: the expert grasps, disturbed now and then, until there are enough successful steps.

python recipes/collect.py demonstrations.steps=50000 demonstrations.path=demos
"""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path

import common
import hydra
import settings
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictSequential

from torchgrasp.data import append_shard, count_shards, open_demonstrations
from torchgrasp.data.files import write_json_atomically
from torchgrasp.errors import ConfigError
from torchgrasp.training import EpisodePool, Progress, one_line_errors

# Rounds of all worlds in a file of demonstrations, which is written whole or not at all.
_SHARD_ROUNDS = 4
# Episodes without one success after which collecting would never end.
_HOPELESS = 200


def collect(cfg: DictConfig, pool: EpisodePool, path: Path) -> dict:
    """Add shards to `path` until its successful episodes have `demonstrations.steps` steps.

    Shard k holds the same episodes whenever it is collected, so a collection that was cut off goes on
    where its last whole shard ended.

    Returns:
        The card of the demonstrations: objects, episodes, successes, bytes.
    """
    _check_origin(cfg, path)
    done, card = count_shards(path), {}
    if done:
        card = open_demonstrations(path).card
    wanted, have = cfg.demonstrations.steps, card.get("successful_steps", 0)
    progress = Progress(wanted, initial=min(wanted, have), description="demonstrations", unit="step")
    expert = common.make_expert(cfg, "train")
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
        if card["episodes"] >= _HOPELESS and not have:
            raise ConfigError(
                f"The expert lifted nothing in {card['episodes']} episodes (env.horizon={cfg.env.horizon}): "
                "give it more steps, or objects that the hand can hold."
            )
    progress.close()
    return card


def demonstrations(cfg: DictConfig, pool: EpisodePool, run_dir: Path) -> Path:
    """The folder of demonstrations that was given, or one below `run_dir`, collected as configured."""
    if cfg.demonstrations.path is None:
        collect(cfg, pool, run_dir / "demonstrations")
        return run_dir / "demonstrations"
    path = Path(cfg.demonstrations.path)
    if not count_shards(path):
        raise ConfigError(f"demonstrations.path={path} holds none: collect them by recipes/collect.py first.")
    _check_origin(cfg, path, ("transforms", "camera", "overhead", "horizon", "action_space"))
    return path


def _check_origin(cfg: DictConfig, path: Path, names: tuple[str, ...] = ()) -> None:
    """Refuse demonstrations that another configuration made; `names` tells what must agree, () for all."""
    plain = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(plain, dict)
    ours = {name: plain[name] for name in ("seed", "env", "objects", "camera", "overhead", "transforms")}
    ours |= {
        "horizon": cfg.env.horizon,
        "action_space": cfg.env.action_space,
        "disturb": plain["collector"]["disturb"],
    }
    file = path / "origin.json"
    if not file.exists():
        if count_shards(path):
            raise ConfigError(f"{path} lacks {file.name}: its origin is unknown, give another folder.")
        path.mkdir(parents=True, exist_ok=True)
        write_json_atomically(file, ours)
        return
    theirs = json.loads(file.read_text())
    differing = [name for name in (names or ours) if ours[name] != theirs.get(name)]
    if differing:
        raise ConfigError(
            f"The demonstrations in {path} were collected with another {', '.join(differing)}: "
            f"configure that as {file} tells, or give another folder."
        )


@hydra.main(version_base=None, config_path="../conf", config_name="td3_bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Collect into `demonstrations.path`, by default outputs/demonstrations."""
    path = Path(cfg.demonstrations.path or Path(cfg.output_dir) / "demonstrations")
    settings.check_values(cfg)
    common.count_points(cfg)
    with common.make_pool(cfg) as pool:
        common.prepare_objects(cfg, "train")
        card = collect(cfg, pool, path)
    print(
        f"{path}: {card['episodes']} episodes, {card['successes']} successful, {card['bytes'] / 1e6:.0f} MB"
    )


if __name__ == "__main__":
    main()
