"""Demonstrations: episodes of one kind, until enough of its steps are stored.

python recipes/collect.py demonstrations.steps=50000 demonstrations.path=demos
python recipes/collect.py demonstrations.kind=failed demonstrations.path=failures
python recipes/collect.py demonstrations.kind=learner demonstrations.policy=<run dir>
"""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from torchgrasp.config import (
    build,
    check_training,
    collect,
    make_pool,
    make_row,
    observed_shapes,
    one_line_errors,
    prepare_objects,
    recipe_main,
)
from torchgrasp.data.files import try_folder
from torchgrasp.interruption import noted


def run(cfg: DictConfig) -> dict:
    """Collect into `demonstrations.path`, by default outputs/demonstrations; returns the card."""
    path = Path(str(cfg.demonstrations.path or f"{cfg.output_dir}/demonstrations"))
    check_training(cfg)
    make_row(build(cfg.replay.codec), None, observed_shapes(cfg))  # refuses what cannot be kept
    try_folder(path)
    with noted(f"The same command goes on with the whole shards in {path}."), make_pool(cfg) as pool:
        prepare_objects(cfg, "train")
        card = collect(cfg, pool, path)
    print(
        f"{path}: {card['episodes']} {card['kind']} episodes of {card['attempts']} run, "
        f"{card['successes']} successful, {card['steps']} steps, {card['bytes'] / 1e6:.0f} MB"
    )
    return card


@recipe_main(config_name="td3_bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Collect as configured."""
    run(cfg)


if __name__ == "__main__":
    main()
