"""What a fine-tuning run takes over from the run that it begins with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from torchgrasp.config.demonstration_sources import learns_alone
from torchgrasp.config.networks import forget_encoder_files
from torchgrasp.config.overrides import given_names
from torchgrasp.config.residual import check_residual, has_residual
from torchgrasp.config.weights_files import read_trained, weights_file
from torchgrasp.data import count_shards
from torchgrasp.errors import ConfigError

# Parts of the configuration, of the task, of the storage and of the demonstrations.
_PARTS = ("model", "camera", "overhead", "transforms", "num_points")
_TASK = ("horizon", "action_space")
_STORAGE = ("codec", "augment")
_DEMONSTRATIONS = ("kind", "count", "path", "steps")
# What is the fine-tuning's own nevertheless: Sec. 6.3, and a residual with its new critic.
_FROZEN = ("model.actor.freeze_encoder", "model.critic.freeze_encoder")
_RESIDUAL = ("model.residual", "model.critic.norm", "model.critic.goal_prediction")


def begun_with(cfg: DictConfig) -> DictConfig:
    """The configuration with what the run or weights file `init` was trained with, and its D_expert.

    A run that is resumed has it already.
    """
    if cfg.offline.updates:
        raise ConfigError("offline.updates leaves no episodes to fine-tune on: leave it out.")
    if cfg.resume is not None:
        return cfg
    if cfg.init is None:
        raise ConfigError("init is missing: give the run directory or weights file that is to be tuned.")
    path = Path(str(cfg.init))
    brought = read_trained(path, cfg.trust).config
    # A correction is learned anew, with a critic of its own, unless `init` has one.
    own = (*_FROZEN, *_RESIDUAL) if has_residual(cfg) and not has_residual(brought) else _FROZEN
    refused = [name for name in given_names() if name.split(".")[0] in _PARTS and not name.startswith(own)]
    if refused:
        raise ConfigError(f"init={path} brings {', '.join(_PARTS)} along: leave out {', '.join(refused)}.")
    plain: Any = OmegaConf.to_container(cfg)
    critic = OmegaConf.to_container(cfg.model.critic, resolve=True)
    plain |= {name: brought[name] for name in _PARTS if name in brought}
    plain["model"] = {"critic": critic, **plain["model"]}  # imitation alone brings none
    for part, names in (("env", _TASK), ("replay", _STORAGE)):
        told = brought.get(part) or {}
        plain[part] |= {name: told[name] for name in names if name in told}
    if cfg.demonstrations.path is None and not learns_alone(cfg):
        plain["demonstrations"] |= _find_demonstrations(path, brought.get("demonstrations") or {})
    begun: Any = OmegaConf.create(plain)
    forget_encoder_files(begun.model)
    for name in own:
        OmegaConf.update(begun, name, OmegaConf.select(cfg, name), force_add=True)
    check_residual(begun)
    return begun


def _find_demonstrations(init: Path, brought: dict[str, Any]) -> dict[str, Any]:
    """The options of the demonstrations that `init` learned from, with the folder where they lie."""
    theirs = {name: brought[name] for name in _DEMONSTRATIONS if name in brought}
    folder = weights_file(init).parent / "demonstrations"
    if theirs.get("path") is None and not count_shards(folder):
        raise ConfigError(
            f"init={init} has no demonstrations beside it, which would be D_expert: give "
            "demonstrations.path=<folder of `torchgrasp collect`>, collected with what init brings along."
        )
    return {**theirs, "path": theirs.get("path") or str(folder)}
