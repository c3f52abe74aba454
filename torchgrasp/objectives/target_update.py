"""Two target critics of different age (Sec. 6.4)."""

from __future__ import annotations

from typing import Any

import torch
from torchrl.objectives.utils import TargetNetUpdater

from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.objectives.side_by_side import SideBySide
from torchgrasp.objectives.td3_bc import GraspTD3BCLoss


class StaggeredTargetUpdate(TargetNetUpdater):
    """The target actor and first target critic follow softly; the other critics are copied rarely.

    Call `step` after each critic update. Buffers go along with parameters. Making the updater copies
    the networks into all targets, so load a checkpoint of the loss after this.

    Args:
        loss_module: a GraspTD3BCLoss.
        tau: share of the online parameters in each soft update: 1 - 0.999 in the paper.
        period: critic updates from one hard copy to the next.

    Example:
        >>> from torchgrasp.geometry import ACTION_BOUND
        >>> from torchgrasp.modules import GraspActor, GraspCritic, PointNet
        >>> networks = GraspActor(PointNet), GraspCritic(PointNet)
        >>> loss = GraspTD3BCLoss(*networks, action_bound=ACTION_BOUND)
        >>> updater = StaggeredTargetUpdate(loss, tau=0.01, period=100)
        >>> updater.step()
        >>> updater.state_dict()["counter"]
        1
    """

    loss_module: GraspTD3BCLoss

    def __init__(self, loss_module: GraspTD3BCLoss, *, tau: float = 0.001, period: int = 3000) -> None:
        if not isinstance(loss_module, GraspTD3BCLoss):
            raise ConfigError(
                f"{type(loss_module).__name__} has no staggered targets: give a GraspTD3BCLoss, "
                "or use torchrl's SoftUpdate or HardUpdate."
            )
        check_range("tau", tau, 0.0, 1.0)
        check_whole("period", period, 1)
        _check_staggered(loss_module)
        super().__init__(loss_module)
        self.tau, self.period, self.counter = tau, period, 0

    @torch.no_grad()
    def copy(self) -> None:
        """Set every target to its source: for networks that were trained by other means meanwhile."""
        loss = self.loss_module
        followed, copied = _critic_targets(loss)
        for pair in ((loss.actor_network_params, loss.target_actor_network_params), followed, *copied):
            _blend(*pair, 1.0)

    def step(self) -> None:
        """Follow with the soft targets and, every `period` calls, copy into the others."""
        self.follow()
        self.count()

    @torch.no_grad()
    def follow(self) -> None:
        """The first half of a step: the soft targets follow. It does the same at every call."""
        loss = self.loss_module
        _blend(loss.actor_network_params, loss.target_actor_network_params, self.tau)
        _blend(*_critic_targets(loss)[0], self.tau)

    @torch.no_grad()
    def count(self) -> None:
        """The second half: counts it and, every `period` calls, copies into the other targets."""
        self.counter += 1
        if self.counter % self.period == 0:
            for pair in _critic_targets(self.loss_module)[1]:
                _blend(*pair, 1.0)


def _check_staggered(loss: GraspTD3BCLoss) -> None:
    if not (loss.has_delayed_critic or isinstance(loss.critic_network, SideBySide)):
        raise ConfigError(
            "staggered_targets=False leaves one set of target parameters: build the loss with "
            "staggered_targets=True or use torchrl's SoftUpdate."
        )


def _critic_targets(loss: GraspTD3BCLoss) -> tuple[tuple[Any, Any], list[tuple[Any, Any]]]:
    """Parameters (source, target) of the critic that follows, and of those that are copied."""
    online, target = loss.critic_network_params, loss.target_critic_network_params
    if loss.has_delayed_critic:
        return (online, target), [(online, loss.target_delayed_critic_network_params)]
    names = [("critics", str(i)) for i in range(len(online["critics"].keys()))]
    first, *others = [(online.get(name), target.get(name)) for name in names]
    return first, others


def _blend(source: Any, target: Any, share: float) -> None:
    """Move each leaf of `target` by `share` of the way to that of `source`; integers jump."""
    moved: list[tuple[Any, Any]] = []
    for key, value in source.items(True, True):
        leaf = target.get(key)
        if share < 1.0 and leaf.is_floating_point():
            moved.append((leaf, value))
        else:
            leaf.copy_(value)
    if moved:
        leaves, values = map(list, zip(*moved, strict=True))
        torch._foreach_lerp_(leaves, values, share)  # pyright: ignore[reportPrivateImportUsage]
