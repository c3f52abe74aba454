"""torchgrasp: closed-loop 6-DoF grasping from point clouds, as TorchRL components.

`load_policy`, `make_env` and `GraspAgent` are imported when they are first used: importing the package
loads nothing else.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchgrasp.config.trained_policy import load_policy as load_policy
    from torchgrasp.config.trained_policy import make_env as make_env
    from torchgrasp.deploy.agent import GraspAgent as GraspAgent

__version__ = "0.2.0"
_LAZY = {
    "load_policy": "torchgrasp.config.trained_policy",
    "make_env": "torchgrasp.config.trained_policy",
    "GraspAgent": "torchgrasp.deploy.agent",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'torchgrasp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
