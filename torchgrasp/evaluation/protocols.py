"""What the paper changes in the environment between its evaluations (Sec. 6.6 and 6.7)."""

from __future__ import annotations

from dataclasses import dataclass

from torchgrasp.errors import ConfigError


@dataclass(frozen=True)
class Protocol:
    """An evaluation of the paper.

    Attributes:
        target_motion: of the target; None leaves the environment's own.
        tabletop: whether episodes begin at the tabletop start (Sec. 6.7).
    """

    target_motion: str | None = None
    tabletop: bool = False


PROTOCOLS = {
    "static": Protocol(),
    "moving": Protocol(target_motion="jitter"),
    "tabletop": Protocol(tabletop=True),
    "handover": Protocol(target_motion="handover"),
}


def find_protocol(name: str) -> Protocol:
    """The protocol of that name."""
    if name not in PROTOCOLS:
        raise ConfigError(f"protocol={name!r} is unknown: give one of {', '.join(PROTOCOLS)}.")
    return PROTOCOLS[name]
