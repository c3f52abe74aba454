"""Speed as ratios within one run: recipes/benchmark.py suite=env|resets|planner|replay|encoder|update|..."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import time
from pathlib import Path

import common
import hydra
import numpy as np
import settings
import torch
from clock import Clock
from learning_bench import benchmark_encoder, benchmark_update
from omegaconf import DictConfig, OmegaConf
from planner_bench import benchmark_planner
from replay_bench import benchmark_replay
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp
from training_bench import benchmark_training

from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.planning import ExpertPolicy
from torchgrasp.runs.process_memory import measure_memory
from torchgrasp.runs.progress import Progress
from torchgrasp.runs.run_directory import hardware, make_run_dir, versions
from torchgrasp.sim import probe_renderer

_RENDER = {"camera": {"_target_": "torchgrasp.sim.RenderCamera"}}


def run_episodes(env: EnvBase, expert: ExpertPolicy, clock: Clock, episodes: int, horizon: int) -> None:
    """Expert episodes in every world, the expert's time counted apart."""
    for _ in range(episodes):
        with clock.part("reset"):
            td = env.reset()
        for _ in range(horizon):
            with clock.part("expert label"):
                td = expert(td)
            with clock.part("torchrl and tensors"):
                td = step_mdp(env.step(td))


def measure(cfg: DictConfig, *, episodes: int) -> dict:
    """Steps a second with point clouds, and where the time goes."""
    env = common.make_env(cfg, "train")
    base = env.base_env
    assert isinstance(base, GraspEnv)
    expert = common.make_expert(cfg, "train")
    run_episodes(env, expert, Clock(), episodes, base.horizon)
    clock = Clock()
    worlds = base.worlds
    clock.wrap(worlds, "drive", "physics: steps")
    clock.wrap(base.actions, "posture", "inverse kinematics")
    clock.wrap(worlds, "close_and_lift", "physics: closing and lifting")
    clock.wrap(worlds, "observe", "camera")
    for transform in env.transform.transforms:  # pyright: ignore[reportGeneralTypeIssues]
        for method in ("_step", "_reset"):
            clock.wrap(transform, method, f"transform {type(transform).__name__}")
    base.start_episodes_at([0] * base.num_envs)
    run_episodes(env, expert, clock, episodes, base.horizon)
    return _table(clock.seconds, episodes * base.num_envs, base.horizon)


def _table(seconds: dict[str, float], episodes: int, horizon: int) -> dict:
    steps = episodes * horizon
    own = sum(value for name, value in seconds.items() if name != "expert label")
    physics = sum(value for name, value in seconds.items() if name.startswith("physics"))
    return {
        "steps_per_second": steps / own,
        "physics_only_steps_per_second": steps / physics,
        "ratio_to_physics_only": physics / own,
        "new_scene_milliseconds": 1e3 * seconds["reset"] / episodes,
        "milliseconds_per_step": {name: 1e3 * value / steps for name, value in sorted(seconds.items())},
    }


def benchmark_env(cfg: DictConfig) -> dict:
    """The environment with point clouds: one world, a batch, rendered, and a peer where one is given."""
    rows = {"one world": measure(cfg, episodes=cfg.episodes)}
    batch = OmegaConf.merge(cfg, {"env": {"num_envs": cfg.batch}})
    rows[f"{cfg.batch} worlds"] = measure(batch, episodes=max(1, cfg.episodes // cfg.batch))  # pyright: ignore
    if probe_renderer().ok:
        rendered = OmegaConf.merge(cfg, _RENDER)
        rows["one world, rendered"] = measure(rendered, episodes=max(1, cfg.episodes // 5))  # pyright: ignore
    for name, row in rows.items():
        print(
            f"{name:22s} {row['steps_per_second']:6.0f} steps/s with point clouds; physics alone "
            f"{row['physics_only_steps_per_second']:6.0f}: ratio {row['ratio_to_physics_only']:.2f}; "
            f"a new scene {row['new_scene_milliseconds']:.1f} ms"
        )
    print("Where a step's time goes, one world:")
    for name, value in sorted(rows["one world"]["milliseconds_per_step"].items(), key=lambda item: -item[1]):
        print(f"  {value:6.3f} ms  {name}{' (not counted)' if name == 'expert label' else ''}")
    if cfg.peer_python is not None:
        rows |= _peers(cfg, rows["one world"]["steps_per_second"])
    return rows


def _peers(cfg: DictConfig, own: float) -> dict:
    """ManiSkill's PickCube in the Python that `peer_python` names, with and without pictures."""
    found = {}
    for mode, steps in (("pictures", 60), ("state", 600)):
        command = [cfg.peer_python, str(Path(__file__).with_name("peer.py")), str(steps), mode]
        done = subprocess.run(
            command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        lines = [line for line in done.stdout.splitlines() if line.startswith("steps_per_second=")]
        if not lines:
            raise ConfigError(f"peer_python={cfg.peer_python} failed: {done.stderr.strip()[-300:]}")
        rate = float(lines[0].split("=")[1])
        found[f"ManiSkill PickCube, {mode}"] = {"steps_per_second": rate, "ratio_to_ours": rate / own}
        print(f"ManiSkill PickCube, wrist camera, {mode:9s} {rate:6.1f} steps/s: {rate / own:.3f} of ours")
    return found


def benchmark_resets(cfg: DictConfig) -> dict:
    """Time and memory of many resets over many objects, one step after each."""
    base = common.make_env(cfg, "train")
    milliseconds, memory = [], {}
    progress = Progress(cfg.resets, description="resets", unit="reset")
    for count in range(1, cfg.resets + 1):
        start = time.perf_counter()
        td = base.reset()
        milliseconds.append(1e3 * (time.perf_counter() - start) / base.batch_size[0])
        base.rand_step(td)
        if count % (cfg.resets // 10) == 0:
            gc.collect()
            memory[count] = measure_memory()["memory/process_mb"]
            print(f"{count} resets: {memory[count]:.0f} MB", flush=True)
        progress.update()
    progress.close()
    marks = list(memory.values())
    warm = milliseconds[len(milliseconds) // 10 :]
    out = {
        "resets": cfg.resets,
        "objects": len(common.make_objects(cfg, "train")),
        "megabytes": memory,
        "growth_after_first_tenth_megabytes": marks[-1] - marks[0],
        "mean_milliseconds": float(np.mean(warm)),
        "median_milliseconds": float(np.median(warm)),
        "p95_milliseconds": float(np.percentile(warm, 95)),
    }
    print(f"{marks[-1] - marks[0]:+.1f} MB after the first tenth of {cfg.resets} resets")
    print(f"A reset takes {out['mean_milliseconds']:.1f} ms on average, 95 % {out['p95_milliseconds']:.1f}")
    return out


def benchmark(cfg: DictConfig) -> dict:
    """Run the suite; print and write its table."""
    suites = {
        "env": benchmark_env,
        "resets": benchmark_resets,
        "planner": benchmark_planner,
        "replay": benchmark_replay,
        "encoder": benchmark_encoder,
        "update": benchmark_update,
        "training": benchmark_training,
    }
    if cfg.suite not in suites:
        raise ConfigError(f"suite={cfg.suite!r} is unknown: give one of {', '.join(suites)}.")
    settings.check_values(cfg)
    torch.set_num_threads(1)
    if cfg.suite in ("env", "resets", "planner"):
        common.prepare_objects(cfg, "train")
    result = {"suite": cfg.suite, "rows": suites[cfg.suite](cfg)}
    result |= {"hardware": hardware(), "versions": versions()}
    run_dir: Path = make_run_dir("benchmark", root=cfg.output_dir)
    (run_dir / "benchmark.json").write_text(json.dumps(result, indent=2))
    print(f"Written to {run_dir}/benchmark.json")
    return result


@hydra.main(version_base=None, config_path="../conf", config_name="benchmark")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Measure as configured."""
    benchmark(cfg)


if __name__ == "__main__":
    main()
