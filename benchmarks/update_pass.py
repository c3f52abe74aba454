"""suite=update: a whole round of updates of actor and critic."""

from __future__ import annotations

from collections.abc import Callable

import torch
from kept_update import compare_kept
from network_passes import Encoder, compare_encoders, make_clouds
from omegaconf import DictConfig
from tensordict import TensorDict

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GraspActor, GraspCritic
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate


def benchmark_update(cfg: DictConfig) -> list[dict]:
    """Two critic updates and one actor update after Eq. (3) and (4), targets included, by encoder.

    Then each kind of update with frozen encoders, on clouds and on features that are kept.
    """
    rows = compare_encoders(cfg, "update", make_update_pass)
    return rows + compare_kept(cfg, make_batch(cfg.clouds.batch, cfg.clouds.points))


def make_update_pass(make: Encoder, options: dict, device: torch.device) -> tuple[Callable[[], None], int]:
    """Two critic updates and one actor update on one batch, and the number of weights."""
    networks = GraspActor(make).to(device), GraspCritic(make).to(device)
    loss = GraspTD3BCLoss(*networks, action_bound=ACTION_BOUND).to(device)
    targets = StaggeredTargetUpdate(loss)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-4)
    data = make_batch(options["batch"], options["points"]).to(device)

    def descend(terms: TensorDict) -> None:
        optimizer.zero_grad(set_to_none=True)
        torch.stack([value for key, value in terms.items() if str(key).startswith("loss_")]).sum().backward()
        optimizer.step()

    def run() -> None:
        for _ in range(2):
            descend(loss.critic_loss(data))
            targets.step()
        descend(loss.actor_loss(data))

    return run, sum(p.numel() for p in loss.parameters())


def make_batch(batch: int, points: int) -> TensorDict:
    """Transitions as the replay buffer gives them, of arbitrary labels."""
    generator = torch.Generator().manual_seed(1)

    def state(seed: int) -> dict:
        time_left = torch.rand(batch, 1, generator=generator)
        plane = torch.nn.functional.normalize(torch.randn(batch, 4, generator=generator), dim=-1)
        return {"points": make_clouds(batch, points, seed=seed), "time_left": time_left, "table_plane": plane}

    goal = torch.nn.functional.normalize(torch.randn(batch, 4, generator=generator), dim=-1)
    ends = torch.rand(batch, 1, generator=generator)
    action = 0.05 * (torch.rand(2, batch, 6, generator=generator) - 0.5)
    return TensorDict(
        {
            **state(2),
            "action": action[0],
            "expert_action": action[1],
            "goal": torch.cat((0.1 * torch.rand(batch, 3, generator=generator), goal), dim=-1),
            "next": {**state(3), "reward": (ends > 0.97).float(), "terminated": ends > 0.95},
        },
        [batch],
    )
