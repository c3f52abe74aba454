"""Grasp prediction errors of trained networks, as configured (Sec. 6.5, Table 5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.config.environments import LEARNED_FROM, make_expert, make_objects
from torchgrasp.config.networks import rebuild_acting
from torchgrasp.config.policies import POLICIES
from torchgrasp.config.weights_files import read_trained
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.grasp_prediction import find_predictors, measure_grasp_prediction
from torchgrasp.rollouts import EpisodePool

# What is needed of a step, besides the keys that every evaluation keeps.
PREDICTED_FROM = (*LEARNED_FROM, keys.T_BASE_OBJECT, keys.OBJECT_ID, keys.GRASP_PREDICTION)


def make_predictors(cfg: DictConfig, name: str) -> dict[str, TensorDictModuleBase]:
    """The networks of policy `name` that predict grasps."""
    if name in POLICIES:
        raise ConfigError(
            f"grasp_prediction=true with policy={name}, which predicts no grasps: give a run directory or a "
            "weights file."
        )
    return find_predictors(rebuild_acting(read_trained(Path(name), cfg.trust), critic=True))


def predict_grasps(
    cfg: DictConfig, pool: EpisodePool, predictors: Mapping[str, TensorDictModuleBase], watch: Callable
) -> dict[str, dict]:
    """{network: its row of Table 5} on the evaluation's scenes, which the expert drives through."""
    return measure_grasp_prediction(
        pool,
        make_expert(cfg, "test"),
        make_objects(cfg, "test"),
        predictors,
        num_episodes=cfg.evaluation.episodes,
        num_envs=cfg.evaluation.num_envs,
        watch=watch,
    )
