"""Episodes of a policy as mp4 files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from torchrl.envs import TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.names import file_stem
from torchgrasp.report.film import EndingRecorder, EpisodeFilm, write_video
from torchgrasp.rollouts import SerialPool
from torchgrasp.rollouts.episode_pool import run_episodes
from torchgrasp.runs import Progress


def record_films(
    env: TransformedEnv, policy: Callable, folder: Path, *, num_episodes: int, fps: float
) -> list[Path]:
    """Write the first episodes of an environment as mp4 files; returns their paths.

    They are run in this process: an episode is the same in every process, and others need not hand over
    pictures and poses.

    Args:
        env: a GraspEnv with its transforms.
        policy: that acts.
        folder: of the files.
        num_episodes: how many.
        fps: frames a second; a step is a frame.

    Raises:
        ConfigError: where env is none of GraspEnv with transforms.
    """
    base = env.base_env if isinstance(env, TransformedEnv) else env
    if not isinstance(env, TransformedEnv) or not isinstance(base, GraspEnv):
        raise ConfigError(f"env is a {type(base).__name__}: give a TransformedEnv around a GraspEnv.")
    seen_by = base.cameras["camera"].intrinsics
    recorder, film = EndingRecorder(base), EpisodeFilm(base.objects, intrinsics=seen_by)
    paths: list[Path] = []
    with (
        Progress(num_episodes, description="videos", unit="video") as progress,
        SerialPool({"test": lambda: env}) as pool,
    ):
        episodes = run_episodes(pool, "test", policy, num_episodes=num_episodes, num_envs=base.num_envs)
        for episode in episodes:
            word = "lifted" if episode.success else "failed"
            stem = file_stem(episode.object_name.replace("/", "_"))
            path = folder / f"{len(paths):03d}_{stem}_{word}.mp4"
            ending = recorder.endings.pop(episode.world - base.first_world, ())
            paths.append(write_video(path, film.frames(episode.steps, ending), fps=fps))
            progress.update()
    return paths
