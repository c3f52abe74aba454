"""What policies must have in common, so that their mean is a policy, and what can be left out of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from torchgrasp.config.networks import make_mirror, rebuild_acting, without_correction
from torchgrasp.config.provenance import find_differing
from torchgrasp.config.residual import has_residual
from torchgrasp.config.weights_files import TrainedWeights, read_trained
from torchgrasp.errors import ConfigError
from torchgrasp.modules.policy import join_policy
from torchgrasp.runs import load_weights
from torchgrasp.runs.averaged_weights import Loaded

# Of an actor: what it reads and how, which the shapes of its weights do not tell.
_READS = ("goal_input", "table_input", "state_inputs")
_REMEDIES = {
    "model.residual": ", or leave the correction out by --uncorrected",
    "model.mirrored": ", or have the mean act over reflections by --mirrored",
}


def load_uncorrected(path: Path) -> Loaded:
    """What `load_weights` gives of a file, as the policy was before reinforcement corrected it, if it did.

    The file has been checked (`check_averaged`).
    """
    plain = without_correction(TrainedWeights(path, *load_weights(path)))
    return plain.states, plain.config


def check_averaged(
    paths: Sequence[Path], *, mirrored: bool, uncorrected: bool = False, trust: Iterable[str] = ()
) -> None:
    """Refuse policies that see, move or act otherwise than the first, before their mean is made.

    Args:
        paths: weights files.
        mirrored: whether the mean acts by the mean over reflections.
        uncorrected: whether corrections are left out.
        trust: packages besides torchgrasp and TorchRL whose classes the files may name.

    Raises:
        ConfigError: names what differs, or why a policy cannot act by the mean over reflections.
        CheckpointError: where a file cannot be read.
    """
    policies = [read_trained(path, trust) for path in paths]
    first, *others = map(without_correction, policies) if uncorrected else policies
    for other in others:
        if differing := find_differing(*map(_describe_task, (first, other))):
            raise ConfigError(
                f"{other.path} learned with other {', '.join(differing)} than {first.path}: average policies "
                "that see and move alike."
            )
        one, another = (_describe_acting(each, mirrored) for each in (first, other))
        if names := [name for name in one if one[name] != another[name]]:
            remedies = [_REMEDIES[name] for name in names] if _REMEDIES.keys() >= set(names) else []
            raise ConfigError(
                f"{other.path} acts otherwise than {first.path}, by its {', '.join(names)}: average policies "
                f"that act alike{''.join(remedies)}."
            )
    if uncorrected:
        if not any(has_residual(policy.config) for policy in policies):
            raise ConfigError(f"{first.path} has no correction to leave out: leave out --uncorrected.")
        rebuild_acting(first)
    if mirrored:
        _check_mirrored(first)


def _describe_task(trained: TrainedWeights) -> dict[str, Any]:
    return {**trained.config, **trained.config["env"]}


def _describe_acting(trained: TrainedWeights, mirrored: bool) -> dict[str, Any]:
    model = trained.config["model"]
    told = {f"model.actor.{name}": model["actor"].get(name) or None for name in _READS}
    told["model.residual"] = model.get("residual")
    return told if mirrored else {**told, "model.mirrored": bool(model.get("mirrored"))}


def _check_mirrored(trained: TrainedWeights) -> None:
    if not (trained.config.get("replay") or {}).get("augment"):
        raise ConfigError(
            f"{trained.path} learned from states as they are (replay.augment=null): it knows no reflections, "
            "and their mean would be of no use. Leave out --mirrored."
        )
    join_policy(rebuild_acting(trained), make_mirror({"mirrored": True}))
