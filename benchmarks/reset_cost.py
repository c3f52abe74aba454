"""suite=resets: time of a reset, and whether memory grows over many of them."""

from __future__ import annotations

import gc
import time

import numpy as np
from omegaconf import DictConfig

from torchgrasp.config import make_split_env
from torchgrasp.config.environments import make_objects
from torchgrasp.runs import Progress
from torchgrasp.runs.process_memory import measure_memory


def benchmark_resets(cfg: DictConfig) -> dict:
    """Time and memory of many resets over many objects, one step after each."""
    milliseconds, megabytes = _reset_often(cfg)
    marks = list(megabytes.values())
    warm = milliseconds[len(milliseconds) // 10 :]
    row = {
        "resets": cfg.resets,
        "objects": len(make_objects(cfg, "train")),
        "megabytes": megabytes,
        "growth_after_first_tenth_megabytes": marks[-1] - marks[0],
        "mean_milliseconds": float(np.mean(warm)),
        "median_milliseconds": float(np.median(warm)),
        "p95_milliseconds": float(np.percentile(warm, 95)),
    }
    print(f"{marks[-1] - marks[0]:+.1f} MB after the first tenth of {cfg.resets} resets")
    print(f"A reset takes {row['mean_milliseconds']:.1f} ms on average, 95 % {row['p95_milliseconds']:.1f}")
    return row


def _reset_often(cfg: DictConfig) -> tuple[list[float], dict[int, float]]:
    """Milliseconds of each reset for a world, and the process's megabytes by the resets until then."""
    env = make_split_env(cfg, "train")
    milliseconds, megabytes = [], {}
    with Progress(cfg.resets, description="resets", unit="reset") as progress:
        for count in range(1, cfg.resets + 1):
            start = time.perf_counter()
            td = env.reset()
            milliseconds.append(1e3 * (time.perf_counter() - start) / env.batch_size[0])
            env.rand_step(td)
            if count % (cfg.resets // 10) == 0:
                gc.collect()
                megabytes[count] = measure_memory()["memory/process_mb"]
                print(f"{count} resets: {megabytes[count]:.0f} MB", flush=True)
            progress.update()
    return milliseconds, megabytes
