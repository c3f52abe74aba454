"""torchgrasp: closed-loop 6-DoF grasping from point clouds, as TorchRL components.

`load_policy` and `make_env` are imported when they are first used: importing the package loads nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchgrasp.config.trained_policy import load_policy as load_policy
    from torchgrasp.config.trained_policy import make_env as make_env

__version__ = "0.2.0"
_LAZY = ("load_policy", "make_env")


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from torchgrasp.config import trained_policy

        return getattr(trained_policy, name)
    raise AttributeError(f"module 'torchgrasp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
