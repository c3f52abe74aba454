"""The losses under contract, on small networks, and batches for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.objectives import LossModule

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.objectives import GoalAuxLoss, GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.objectives.grasp_loss import GraspLoss

STATE = 5


class Net(nn.Module):
    """An MLP with one head an output, small enough for gradients of every sample."""

    def __init__(self, num_inputs: int, *sizes: int) -> None:
        super().__init__()
        self.trunk = nn.Sequential(nn.Linear(num_inputs, 8), nn.Tanh())
        self.heads = nn.ModuleList(nn.Linear(8, size) for size in sizes)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        feature = self.trunk(torch.cat(inputs, dim=-1))
        return tuple(0.2 * head(feature) for head in self.heads)


Names = dict[str, str | tuple[str, ...]]


def make_actor(names: Names) -> TensorDictModule:
    written = [names.get(name, name) for name in ("action", "goal_prediction")]
    return TensorDictModule(Net(STATE, 6, 7), ["observation"], written)


def make_critic(names: Names) -> TensorDictModule:
    written = [names.get(name, name) for name in ("state_action_value", "goal_prediction")]
    return TensorDictModule(Net(STATE + 6, 2, 7), ["observation", names.get("action", "action")], written)


def make_bc(names: Names, **options) -> GraspLoss:
    return PoseBCLoss(make_actor(names), aux_weight=0.5, **options)


def make_aux(names: Names, **options) -> GraspLoss:
    return GoalAuxLoss(make_actor(names), success_only=True, **options)


def make_td3(names: Names, **options) -> GraspLoss:
    loss = GraspTD3BCLoss(
        make_actor(names),
        make_critic(names),
        policy_noise=0.0,
        hindsight=True,
        bc_weight=0.3,
        action_bound=ACTION_BOUND,
        **options,
    )
    StaggeredTargetUpdate(loss)
    return loss


@dataclass(frozen=True)
class Case:
    """How a loss is made, with names for keys that are not its defaults."""

    kind: type[LossModule]
    make: Callable[..., GraspLoss]

    def __call__(self, names: Names | None = None, **options) -> GraspLoss:
        torch.manual_seed(0)
        loss = self.make(names or {}, **options)
        if names:
            loss.set_keys(**names)
        return loss


CASES = [Case(PoseBCLoss, make_bc), Case(GoalAuxLoss, make_aux), Case(GraspTD3BCLoss, make_td3)]


def make_batch(*shape: int) -> TensorDict:
    """Transitions with every label and mask, some of each true."""
    generator = torch.Generator().manual_seed(1)

    def normal(*size: int) -> Tensor:
        return 0.3 * torch.randn(*shape, *size, generator=generator)

    def chance() -> Tensor:
        return torch.rand(*shape, 1, generator=generator) < 0.6

    entries = {
        "observation": normal(STATE),
        "action": normal(6),
        "expert_action": normal(6),
        "has_expert": chance(),
        "goal": normal(7),
        "has_goal": chance(),
        "episode_success": chance(),
        "perturbed": chance(),
        "priority_weight": torch.rand(shape, generator=generator) + 0.5,
        "steps_to_next_obs": torch.randint(2, 4, (*shape, 1), generator=generator),
        "next": {"observation": normal(STATE), "reward": normal(1), "terminated": chance() & chance()},
    }
    entries["next"]["done"] = entries["next"]["terminated"] | chance()
    return TensorDict(entries, shape)


def losses(out: TensorDict) -> dict[str, Tensor]:
    return {key: value for key, value in out.items() if key.startswith("loss_")}


def total(out: TensorDict) -> Tensor:
    return torch.stack(list(losses(out).values())).sum()


def gradients(loss: GraspLoss) -> dict[str, Tensor]:
    return {name: p.grad.clone() for name, p in loss.named_parameters() if p.grad is not None}


def assert_same(found, expected) -> None:
    assert set(found.keys()) == set(expected.keys())
    for key in found.keys():  # noqa: SIM118
        torch.testing.assert_close(found[key], expected[key], msg=lambda text, key=key: f"{key}: {text}")
