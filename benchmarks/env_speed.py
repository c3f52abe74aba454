"""suite=env: steps a second with point clouds, and where their time goes."""

from __future__ import annotations

import os
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from torchgrasp.config import make_expert, make_split_env
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.planning import ExpertPolicy
from torchgrasp.runs import Stopwatch
from torchgrasp.sim import probe_renderer

_RENDER = {"camera": {"_target_": "torchgrasp.sim.RenderCamera"}}
_MUJOCO = {"engine": {"_target_": "torchgrasp.sim.MujocoEngine"}}


def benchmark_env(cfg: DictConfig) -> dict:
    """The environment with point clouds: one world, a batch, the other engine, rendered, and a given peer."""
    if cfg.peer_python is not None and shutil.which(cfg.peer_python) is None:
        raise ConfigError(
            f"peer_python={cfg.peer_python} is no program: name a Python with mani-skill installed."
        )
    rows = {"one world": measure_steps(cfg, episodes=cfg.episodes)}
    batch = OmegaConf.merge(cfg, {"env": {"num_envs": cfg.batch}})
    rows[f"{cfg.batch} worlds"] = measure_steps(batch, episodes=max(1, cfg.episodes // cfg.batch))  # pyright: ignore
    if find_spec("mujoco") is not None:
        other: Any = OmegaConf.merge(cfg, _MUJOCO)
        rows["one world, MuJoCo"] = row = measure_steps(other, episodes=cfg.episodes)
        row["ratio_to_one_world"] = row["steps_per_second"] / rows["one world"]["steps_per_second"]
    if probe_renderer().ok:
        rendered = OmegaConf.merge(cfg, _RENDER)
        rows["one world, rendered"] = measure_steps(rendered, episodes=max(1, cfg.episodes // 5))  # pyright: ignore
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
        rows |= _measure_peer(cfg, rows["one world"]["steps_per_second"])
    return rows


def measure_steps(cfg: DictConfig, *, episodes: int) -> dict:
    """Steps a second with point clouds, and where the time goes; as many episodes warm up."""
    env = make_split_env(cfg, "train")
    base = env.base_env
    assert isinstance(base, GraspEnv)
    expert = make_expert(cfg, "train")
    _run_episodes(env, expert, Stopwatch(), episodes, base.horizon)
    stopwatch = Stopwatch()
    worlds = base.worlds
    stopwatch.wrap(worlds, "drive", "physics: steps")
    stopwatch.wrap(base.actions, "posture", "inverse kinematics")
    stopwatch.wrap(worlds, "close_and_lift", "physics: closing and lifting")
    stopwatch.wrap(worlds, "observe", "camera")
    for transform in env.transform.transforms:  # pyright: ignore[reportGeneralTypeIssues]
        for method in ("_step", "_reset"):
            stopwatch.wrap(transform, method, f"transform {type(transform).__name__}")
    base.start_episodes_at([0] * base.num_envs)
    _run_episodes(env, expert, stopwatch, episodes, base.horizon)
    return _make_row(stopwatch.seconds, episodes * base.num_envs, base.horizon)


def _run_episodes(
    env: EnvBase, expert: ExpertPolicy, stopwatch: Stopwatch, episodes: int, horizon: int
) -> None:
    """Expert episodes in every world, the expert's time counted apart."""
    for _ in range(episodes):
        with stopwatch.part("reset"):
            td = env.reset()
        for _ in range(horizon):
            with stopwatch.part("expert label"):
                td = expert(td)
            with stopwatch.part("torchrl and tensors"):
                td = step_mdp(env.step(td))


def _make_row(seconds: dict[str, float], episodes: int, horizon: int) -> dict:
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


def _measure_peer(cfg: DictConfig, own: float) -> dict:
    """ManiSkill's PickCube in the Python that `peer_python` names, with and without pictures."""
    script, found = str(Path(__file__).with_name("maniskill_peer.py")), {}
    for mode, steps in (("pictures", 60), ("state", 600)):
        command = [cfg.peer_python, script, str(steps), mode]
        done = subprocess.run(
            command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        lines = [line for line in done.stdout.splitlines() if line.startswith("steps_per_second=")]
        if not lines:
            raise ConfigError(
                f"peer_python={cfg.peer_python} failed ({done.stderr.strip()[-300:]}): name a Python with "
                "mani-skill installed."
            )
        rate = float(lines[0].split("=")[1])
        found[f"ManiSkill PickCube, {mode}"] = {"steps_per_second": rate, "ratio_to_ours": rate / own}
        print(f"ManiSkill PickCube, wrist camera, {mode:9s} {rate:6.1f} steps/s: {rate / own:.3f} of ours")
    return found
