"""Who explores and disturbs: entries of conf/exploration, refused at once where they cannot be called."""

from __future__ import annotations

from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictSequential

from torchgrasp.config.environments import make_expert
from torchgrasp.config.parts import build
from torchgrasp.errors import ConfigError

# What disturbs the expert in demonstrations of a kind.
DISTURBANCE = {"perturbed": "disturb", "failed": "disturb_to_fail"}
_OFF = "probability=0 switches it off"
_NO_NOISE = "collector.noise.start=[0,0,0,0,0,0] with the same end switches it off"


def make_demonstrator(cfg: DictConfig, kind: str) -> TensorDictSequential:
    """The expert as it acts in demonstrations of a kind: disturbed, unless that is `expert`."""
    modules: list = [make_expert(cfg, "train")]
    if kind in DISTURBANCE:
        modules.append(build(cfg.collector[DISTURBANCE[kind]]))
    return TensorDictSequential(*modules)


def check_demonstrators(cfg: DictConfig) -> None:
    """Refuse what the demonstrations need and cannot be called."""
    kind = cfg.demonstrations.kind
    needed = {DISTURBANCE[kind]: "or give demonstrations.kind=expert"} if kind in DISTURBANCE else {}
    if kind == "learner" and cfg.demonstrations.expert_start:
        needed["expert_start"] = "or leave demonstrations.expert_start out"
    for name, way in needed.items():
        check_exploration(cfg, name, f"demonstrations.kind={kind}", way)


def check_exploration(cfg: DictConfig, name: str, reader: str, way: str | None = None) -> None:
    """Refuse a `collector.<name>` that cannot be called, though `reader` needs it; `way` is another way."""
    value = OmegaConf.select(cfg, f"collector.{name}")
    if not isinstance(value, DictConfig) or "_target_" not in value:
        off = _NO_NOISE if name == "noise" else _OFF
        raise ConfigError(
            f"collector.{name}={value} with {reader}: configure it ({off}){', ' + way if way else ''}."
        )
