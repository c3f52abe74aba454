"""Checks of a training configuration that need more than one value of it."""

from __future__ import annotations

from omegaconf import DictConfig, OmegaConf

from torchgrasp.config.demonstration_sources import draws_own_alone, list_demonstrations
from torchgrasp.config.exploration import check_demonstrators
from torchgrasp.config.parts import at_place
from torchgrasp.config.residual import check_residual
from torchgrasp.config.schema import Demonstrations, Training
from torchgrasp.config.value_checks import check_section, check_values
from torchgrasp.config.weights_files import check_weights
from torchgrasp.data import count_shards
from torchgrasp.data.demonstration_kinds import check_kind, resolve_count
from torchgrasp.errors import ConfigError
from torchgrasp.runs.checkpoint import checkpoint_exists
from torchgrasp.runs.loggers import check_logger


def check_training(cfg: DictConfig) -> None:
    """Refuse what no training can work with: each value by itself, and demonstrations and weights named."""
    check_values(cfg, Training)
    if cfg.offline.updates == "auto" and not cfg.total_env_steps:
        raise ConfigError(
            "offline.updates=auto makes as many as total_env_steps would, which is 0: give their number."
        )
    with at_place("logger"):
        check_logger(cfg.logger.kind)
    for name, each in list_demonstrations(cfg).items():
        further = name in (cfg.demonstrations.more or {})
        place = f"demonstrations.more.{name}" if further else "demonstrations"
        _check_demonstrations(each.demonstrations, place)
        check_demonstrators(each)
    check_residual(cfg)
    _check_labels(cfg)
    if cfg.init is not None and not checkpoint_exists(cfg.resume):
        check_weights("init", str(cfg.init))


# Of each recipe with a critic: what labels its own episodes, and what to give where that is wanted.
_LABELS = {
    "td3_bc": ("dagger", "experiment=laptop"),
    "hindsight": ("self_imitation", "online.self_imitation=true"),
}


def _check_labels(cfg: DictConfig) -> None:
    """Refuse imitation where the main phase draws its own episodes alone and nothing labels them."""
    option, remedy = _LABELS.get(cfg.recipe, ("", ""))
    if option and cfg.loss.bc_weight and draws_own_alone(cfg) and not cfg.online.get(option):
        raise ConfigError(
            f"loss.bc_weight={cfg.loss.bc_weight}, but the policy learns of its own episodes, whose actions "
            f"nobody labels (replay.online_fraction=1.0, online.{option}=false): give loss.bc_weight=0, or "
            f"{remedy}."
        )


def _check_demonstrations(demonstrations: DictConfig, place: str) -> None:
    """Refuse values of one source, and a kind, a count and a policy that do not go together."""
    check_section(place, OmegaConf.to_container(demonstrations, resolve=True), Demonstrations)
    kind, policy = demonstrations.kind, demonstrations.policy
    with at_place(place):
        resolve_count(demonstrations.count, check_kind(kind))
    given = demonstrations.path is not None and count_shards(str(demonstrations.path)) > 0
    if (kind == "learner") != (policy is not None) and not (given and policy is None):
        raise ConfigError(
            f"{place}.kind={kind} with {place}.policy={policy}: the kind learner needs a policy, a run "
            "directory or weights file; no other kind takes one."
        )
    if policy is not None:
        check_weights(f"{place}.policy", str(policy))
