"""Grasp prediction errors of trained networks while the expert drives (Sec. 6.5, Table 5)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import common
import torch
from albums import GraspAlbum
from networks import load_acting, predicts_goal, reads_goal
from omegaconf import DictConfig
from settings import POLICIES
from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.grasp_prediction import GraspPredictions, GraspPredictionTable
from torchgrasp.geometry import goal_to_pose, invert_pose
from torchgrasp.rollouts.episode_pool import Episode, EpisodePool
from torchgrasp.runs.progress import Progress

# What is needed of a step, besides the keys that every evaluation keeps.
KEPT = (*common.KEPT, keys.T_BASE_OBJECT, keys.OBJECT_ID, keys.GRASP_PREDICTION)


def make_predictors(name: str) -> dict[str, TensorDictModuleBase]:
    """The networks of policy `name` that predict grasps."""
    if name in POLICIES:
        raise ConfigError(
            f"grasp_prediction=true with policy={name}, which predicts no grasps: give a run directory or a "
            "weights file."
        )
    return find_predictors(load_acting(Path(name), critic=True))


def find_predictors(networks: Mapping[str, TensorDictModuleBase]) -> dict[str, TensorDictModuleBase]:
    """Those of a policy's networks that predict grasps, each behind the goal network if it reads goals.

    A critic that reads goals where the actor has no goal network is left out: it is told the answer.
    """
    goal_network = networks.get("goal_network")
    predictors = {} if goal_network is None else {"goal_network": goal_network}
    for each in ("actor", "critic"):
        if each not in networks or not predicts_goal(networks[each]):
            continue
        if not reads_goal(networks[each]):
            predictors[each] = networks[each]
        elif goal_network is not None:
            modules: list = [goal_network, networks[each]]
            predictors[each] = TensorDictSequential(*modules)
    if not predictors:
        raise ConfigError(
            "grasp_prediction=true with networks that predict no goal: train with "
            "model.actor.goal_prediction=true, or leave grasp_prediction out."
        )
    return predictors


def measure(
    cfg: DictConfig, pool: EpisodePool, predictors: dict[str, TensorDictModuleBase], album: GraspAlbum
) -> dict[str, dict]:
    """{network: its row of Table 5} on the evaluation's scenes, which the expert drives through.

    The `album` takes pictures of the first network's predictions.
    """
    policy = GraspPredictions(common.make_expert(cfg, "test"), predictors)
    objects, tables = common.make_objects(cfg, "test"), {name: GraspPredictionTable() for name in predictors}
    for episode in _episodes(cfg, pool, policy):
        grasps = torch.from_numpy(objects[int(episode.steps[keys.OBJECT_ID][0])].grasps)
        steps = episode.steps[episode.steps[keys.HAS_GOAL][:, 0]]
        if not len(steps):
            continue
        T_ee_object = invert_pose(steps[keys.T_BASE_EE]) @ steps[keys.T_BASE_OBJECT]
        known = T_ee_object[:, None] @ grasps
        for name, table in tables.items():
            predicted = goal_to_pose(steps[keys.GRASP_PREDICTION, name])
            table.add(predicted, goal_to_pose(steps[keys.GOAL]), known=known)
            if name == next(iter(tables)):
                album.add(episode.object_name, steps, predicted, known)
    return {name: table.summary() for name, table in tables.items()}


def _episodes(cfg: DictConfig, pool: EpisodePool, policy: GraspPredictions) -> Iterator[Episode]:
    """The evaluation's episodes, as `common.evaluate` counts them."""
    wanted = cfg.evaluation.episodes
    progress = Progress(wanted, description="grasp prediction", unit="episode")
    done = 0
    for batch in pool.run("test", common.for_workers(policy), range(-(-wanted // cfg.evaluation.num_envs))):
        for episode in batch[: wanted - done]:
            done += 1
            progress.update()
            yield episode
    progress.close()
