"""Speed as ratios to the bare physics, in one run: python recipes/benchmark.py suite=env."""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import common
import hydra
import torch
from omegaconf import DictConfig
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.planning import ExpertPolicy
from torchgrasp.training import hardware, make_run_dir, one_line_errors, versions


class Clock:
    """Seconds by part, exclusive of parts inside."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside = 0.0

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time spent inside as `name`."""
        outer, self._inside, start = self._inside, 0.0, time.perf_counter()
        try:
            yield
        finally:
            total = time.perf_counter() - start
            self.seconds[name] += total - self._inside
            self._inside = outer + total

    def wrap(self, owner: object, method: str, name: str) -> None:
        """Count every call of a method as `name`."""
        inner: Callable = getattr(owner, method)

        def timed(*args: object, **kwargs: object) -> object:
            with self.part(name):
                return inner(*args, **kwargs)

        setattr(owner, method, timed)


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


def benchmark_env(cfg: DictConfig) -> dict:
    """Steps a second with point clouds, and where the time goes."""
    env = common.make_env(cfg, "train")
    base = env.base_env
    assert isinstance(base, GraspEnv)
    expert = ExpertPolicy(base.objects, horizon=base.horizon)
    run_episodes(env, expert, Clock(), cfg.episodes, base.horizon)
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
    run_episodes(env, expert, clock, cfg.episodes, base.horizon)
    return _table(clock.seconds, cfg.episodes * base.num_envs, base.horizon)


def _table(seconds: dict[str, float], episodes: int, horizon: int) -> dict:
    steps = episodes * horizon
    own = sum(value for name, value in seconds.items() if name != "expert label")
    physics = sum(value for name, value in seconds.items() if name.startswith("physics"))
    return {
        "steps_per_second": steps / own,
        "physics_only_steps_per_second": steps / physics,
        "ratio_to_physics_only": physics / own,
        "milliseconds_per_step": {name: 1e3 * value / steps for name, value in sorted(seconds.items())},
        "new_scene_milliseconds": 1e3 * seconds["reset"] / episodes,
    }


def benchmark(cfg: DictConfig) -> dict:
    """Run the suite; print and write its table."""
    if cfg.suite != "env":
        raise ConfigError(f"suite={cfg.suite!r} is unknown: give env.")
    torch.set_num_threads(1)
    result = {"suite": cfg.suite, **benchmark_env(cfg), "hardware": hardware(), "versions": versions()}
    run_dir: Path = make_run_dir("benchmark", root=cfg.output_dir)
    (run_dir / "benchmark.json").write_text(json.dumps(result, indent=2))
    print(
        f"{result['steps_per_second']:.0f} steps/s with point clouds, one core, {cfg.env.num_envs} world(s)"
    )
    print(
        f"{result['physics_only_steps_per_second']:.0f} steps/s of physics alone: "
        f"ratio {result['ratio_to_physics_only']:.2f}; "
        f"a new scene takes {result['new_scene_milliseconds']:.1f} ms"
    )
    for name, value in sorted(result["milliseconds_per_step"].items(), key=lambda item: -item[1]):
        print(f"  {value:6.3f} ms a step  {name}")
    print(f"Written to {run_dir}/benchmark.json")
    return result


@hydra.main(version_base=None, config_path="../conf", config_name="benchmark")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Measure as configured."""
    benchmark(cfg)


if __name__ == "__main__":
    main()
