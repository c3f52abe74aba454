"""Success of a policy: recipes/evaluate.py policy=outputs/td3_bc/<date_time> episodes=200 seed=1000."""

from __future__ import annotations

import time

import common
import hydra
from omegaconf import DictConfig, OmegaConf

from torchgrasp.training import make_run_dir, one_line_errors, write_summary


def evaluate(cfg: DictConfig) -> dict:
    """Run `episodes` scenes of `objects.split`; write and return the summary."""
    started = time.monotonic()
    cfg = common.evaluation_config(cfg)
    policy = common.make_policy(cfg, cfg.policy)
    with common.make_pool(cfg) as pool:
        common.prepare_objects(cfg, "test")
        table = common.evaluate(cfg, pool, policy, str(cfg.policy)).summary()
    run_dir = make_run_dir("evaluate", root=cfg.output_dir)
    OmegaConf.save(cfg, run_dir / "config.yaml", resolve=True)
    summary = {
        **table,
        "policy": str(cfg.policy),
        "protocol": cfg.protocol,
        "wall_seconds": time.monotonic() - started,
        "env_steps": table["episodes"] * cfg.env.horizon,
        "gradient_steps": 0,
    }
    common.print_comparison(cfg, {str(cfg.policy): table})
    print(f"Written to {run_dir}: summary.json")
    return write_summary(run_dir, summary)


@hydra.main(version_base=None, config_path="../conf", config_name="evaluate")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Evaluate as configured."""
    evaluate(cfg)


if __name__ == "__main__":
    main()
