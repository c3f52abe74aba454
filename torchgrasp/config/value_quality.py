"""What a trained critic knows, as configured."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.config.networks import rebuild_acting
from torchgrasp.config.policies import POLICIES
from torchgrasp.config.weights_files import read_trained
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.value_quality import ValueTable, WatchingCritic


def watch_values(
    cfg: DictConfig, policy: TensorDictModuleBase
) -> tuple[TensorDictModuleBase, ValueTable | None]:
    """The policy, watched by its run's critic where `value_quality` asks for it, and the table to fill."""
    if cfg.value_quality is None:
        return policy, None
    name = str(cfg.policy)
    networks = {} if name in POLICIES else rebuild_acting(read_trained(Path(name), cfg.trust), critic=True)
    if "critic" not in networks:
        raise ConfigError(
            f"value_quality={cfg.value_quality} with policy={name}, which has no critic: give the run "
            "directory or weights file of td3_bc or hindsight."
        )
    if keys.STATE_ACTION_VALUE not in policy.out_keys:
        policy = WatchingCritic(policy, networks["critic"])
    if keys.GOAL in policy.in_keys:
        raise ConfigError(
            f"value_quality={cfg.value_quality} with policy={name}, whose critic alone reads the goal: "
            "nothing tells it that here. Leave value_quality out."
        )
    return policy, ValueTable(gamma=cfg.value_quality)
