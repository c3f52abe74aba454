"""suite=update, frozen encoders: updates of each kind on clouds, and on features that are kept."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import torch
from omegaconf import DictConfig
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GraspActor, GraspCritic, PointNet, split_network
from torchgrasp.objectives import GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.transforms import KeepFeatures

_REPEATS = 10  # for each of `clouds.repeats`: an update on features takes milliseconds


def compare_kept(cfg: DictConfig, batch: TensorDict) -> list[dict]:
    """Milliseconds of an update of imitation, of the critic and of the actor, encoders frozen."""
    torch.set_num_threads(cfg.clouds.threads)
    torch.manual_seed(0)
    whole = [
        GraspActor(PointNet, freeze_encoder=True),
        GraspCritic(PointNet, fusion="late", freeze_encoder=True),
    ]
    halves = [split_network(each, ("features", name)) for each, name in zip(whole, "ac", strict=True)]
    modules: list = [encoder for encoder, _ in halves]
    kept = KeepFeatures(TensorDictSequential(*modules))(batch.copy()).exclude("points", ("next", "points"))
    rows = [
        _measure("pointnet, frozen", whole, batch, cfg.clouds.repeats),
        _measure(
            "pointnet, features kept", [rest for _, rest in halves], kept, _REPEATS * cfg.clouds.repeats
        ),
    ]
    for row in rows:
        figures = ", ".join(
            f"{kind} {1e3 * row[kind]:.1f} ms (x {rows[0][kind] / row[kind]:.1f})"
            for kind in ("imitation", "critic", "actor")
        )
        print(f"update {row['name']:26} {figures}")
    return rows


def _measure(name: str, networks: list[TensorDictModuleBase], batch: TensorDict, repeats: int) -> dict:
    actor, critic = networks
    loss, imitation = (
        GraspTD3BCLoss(actor, critic, action_bound=ACTION_BOUND),
        PoseBCLoss(actor, aux_weight=1.0),
    )
    targets = StaggeredTargetUpdate(loss)
    adams = [
        torch.optim.Adam([p for p in each.parameters() if p.requires_grad], fused=True) for each in networks
    ]

    def descend(optimizer: torch.optim.Optimizer, terms: TensorDict) -> None:
        optimizer.zero_grad(set_to_none=True)
        torch.stack([value for key, value in terms.items() if str(key).startswith("loss_")]).sum().backward()
        optimizer.step()

    def update_critic() -> None:
        descend(adams[1], loss.critic_loss(batch))
        targets.step()

    updates = {
        "imitation": lambda: descend(adams[0], imitation(batch)),
        "critic": update_critic,
        "actor": lambda: descend(adams[0], loss.actor_loss(batch)),
    }
    return {"name": name, **{kind: _time(run, repeats) for kind, run in updates.items()}}


def _time(run: Callable[[], None], repeats: int) -> float:
    """Median seconds, after one that warms up."""
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])
