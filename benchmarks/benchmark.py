"""Speed as ratios within one run: python benchmarks/benchmark.py suite=env|resets|preparation|planner|...

Every suite is a function of the configuration that prints its figures and returns them. This folder is in a
checkout only, beside an installed torchgrasp.
"""

from __future__ import annotations

import json

import hydra
import torch
from benchmark_schema import Benchmark
from critics import benchmark_critics
from encoder_pass import benchmark_encoder
from env_speed import benchmark_env
from expert_comparison import benchmark_planner
from exported_policy import benchmark_export
from franka_loop import benchmark_franka
from grasp_agent import benchmark_agent
from learner_updates import benchmark_learner
from neighbours import benchmark_neighbours
from omegaconf import DictConfig
from preparation_time import benchmark_preparation
from replay_buffer import benchmark_replay
from reset_cost import benchmark_resets
from scale import benchmark_scale
from training_throughput import benchmark_training
from update_pass import benchmark_update

from torchgrasp.config import check_values, one_line_errors, prepare_objects
from torchgrasp.errors import ConfigError
from torchgrasp.runs import hardware, make_run_dir, versions

_SUITES = {
    "env": benchmark_env,
    "resets": benchmark_resets,
    "preparation": benchmark_preparation,
    "planner": benchmark_planner,
    "replay": benchmark_replay,
    "encoder": benchmark_encoder,
    "update": benchmark_update,
    "learner": benchmark_learner,
    "neighbours": benchmark_neighbours,
    "training": benchmark_training,
    "scale": benchmark_scale,
    "critics": benchmark_critics,
    "agent": benchmark_agent,
    "export": benchmark_export,
    "franka": benchmark_franka,
}
# Those that step the environment of this configuration.
_WITH_OBJECTS = ("env", "resets", "planner")


def benchmark(cfg: DictConfig) -> dict:
    """Run the suite; print and write its table."""
    if cfg.suite not in _SUITES:
        raise ConfigError(f"suite={cfg.suite!r} is unknown: give one of {', '.join(_SUITES)}.")
    check_values(cfg, Benchmark)
    torch.set_num_threads(1)
    if cfg.suite in _WITH_OBJECTS:
        prepare_objects(cfg, "train")
    result = {"suite": cfg.suite, "rows": _SUITES[cfg.suite](cfg)}
    result |= {"hardware": hardware(), "versions": versions()}
    files = {"benchmark.json": json.dumps(result, indent=2)}
    run_dir = make_run_dir("benchmark", root=str(cfg.output_dir), files=files)
    print(f"Written to {run_dir}/benchmark.json")
    return result


@hydra.main(version_base=None, config_path=".", config_name="benchmark")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Measure as configured."""
    benchmark(cfg)


if __name__ == "__main__":
    main()
