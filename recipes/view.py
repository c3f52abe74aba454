"""Episodes live in the browser: recipes/view.py policy=expert, or a run directory, as for evaluate.py."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import TransformedEnv

from torchgrasp.config import (
    build,
    evaluation_config,
    make_policy,
    make_split_env,
    one_line_errors,
    prepare_objects,
    recipe_main,
)
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation import SuccessTable
from torchgrasp.report.viewer import EpisodeViewer
from torchgrasp.report.viewer_panel import Skipped
from torchgrasp.rollouts import SerialPool


def view(cfg: DictConfig) -> dict[str, dict]:
    """Show `episodes` scenes, or all until ctrl-C; return each policy's success, skipped scenes left out."""
    endless = cfg.episodes is None
    finite: Any = OmegaConf.merge(cfg, {"episodes": 1}) if endless else cfg
    cfg = evaluation_config(finite)
    if cfg.evaluation.num_envs != 1:
        raise ConfigError(f"evaluation.num_envs={cfg.evaluation.num_envs}: the page shows one world, give 1.")
    names = list(dict.fromkeys((str(cfg.policy), "expert", "random")))
    playing = {name: make_policy(cfg, name).eval() for name in names}
    env = make_split_env(cfg, "test")
    tables = {name: SuccessTable() for name in names}
    period = build(cfg.env.physics).control_period
    with EpisodeViewer(
        policies=names,
        host=cfg.host,
        port=cfg.port,
        speed=cfg.speed,
        step_seconds=period,
        robot=cfg.robot,
    ) as viewer:
        print(f"Open {viewer.address} in a browser; ctrl-C ends.", flush=True)
        try:
            prepare_objects(cfg, "test")
            play(viewer, env, playing, tables, itertools.count() if endless else range(cfg.episodes))
        finally:  # also at ctrl-C, the end of endless playing
            for name, table in tables.items():
                if table.episodes:
                    print(f"{name}: lifted {table.successes} of {table.episodes}")
    return {name: table.summary() for name, table in tables.items() if table.episodes}


def play(
    viewer: EpisodeViewer,
    env: TransformedEnv,
    playing: Mapping[str, TensorDictModuleBase],
    tables: Mapping[str, SuccessTable],
    numbers: Iterable[int],
) -> None:
    """Run the episodes of these numbers by whichever policy the page has chosen when they begin."""
    base = env.base_env
    assert isinstance(base, GraspEnv)
    with SerialPool({"test": lambda: env}) as pool:
        for number in numbers:
            name = viewer.policy
            try:
                ((episode,),) = pool.run("test", viewer.watch(playing[name], base), [number])
            except Skipped:
                continue
            tables[name].add(episode.object_name, episode.success, cause=episode.failure)
            viewer.show_result(name, episode, tables[name])


@recipe_main(config_name="view")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Show as configured."""
    view(cfg)


if __name__ == "__main__":
    main()
