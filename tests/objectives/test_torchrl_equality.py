"""With imitation and goals off, GraspTD3BCLoss is TorchRL's TD3Loss and DDPGLoss: values and gradients."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import Bounded
from torchrl.modules import MLP, Actor, ValueOperator
from torchrl.objectives import DDPGLoss, HardUpdate, SoftUpdate, TD3Loss

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.objectives import GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate

GAMMA = 0.9
SHAPES = [(8,), (4, 3), (2, 2, 3)]


def make_actor() -> TensorDictModule:
    return Actor(nn.Sequential(MLP(3, 2, num_cells=[8]), nn.Tanh()), in_keys=["observation"])


def make_critics(count: int) -> list[TensorDictModule]:
    return [ValueOperator(MLP(5, 1, num_cells=[8]), in_keys=["observation", "action"]) for _ in range(count)]


def make_batch(*shape: int) -> TensorDict:
    """Transitions that go on, that terminated (and are done) and that were truncated (and are done)."""
    generator = torch.Generator().manual_seed(3)
    end = torch.randint(3, (*shape, 1), generator=generator)
    terminated, truncated = end == 1, end == 2
    following = {
        "observation": torch.randn(*shape, 3, generator=generator),
        "reward": 0.2 * torch.randn(*shape, 1, generator=generator),
        **{"terminated": terminated, "truncated": truncated, "done": terminated | truncated},
    }
    state = {"observation": torch.randn(*shape, 3, generator=generator)}
    action = torch.rand(*shape, 2, generator=generator) * 2 - 1
    return TensorDict({**state, "action": action, "next": following}, shape)


def pair(
    kind, *, num_critics: int, loss_function: str, noise: float = 0.0, bound: float = 1.0, tau: float = 1.0
):
    """TorchRL's loss and ours on copies of the same networks, and an updater of each one's targets."""
    torch.manual_seed(0)
    spec = Bounded(-bound, bound, (2,))
    actor, critics = make_actor(), make_critics(num_critics)
    theirs_on = deepcopy((actor, critics))
    ours = GraspTD3BCLoss(
        actor,
        critics,
        bc_weight=0.0,
        aux_weight=0.0,
        action_spec=spec,
        policy_noise=noise,
        noise_clip=0.3,
    ).make_value_estimator(gamma=GAMMA)
    if kind is TD3Loss:
        noises = {"policy_noise": bound * noise, "noise_clip": bound * 0.3}
        theirs = TD3Loss(*theirs_on, action_spec=spec, **noises, loss_function=loss_function)
    else:
        theirs = DDPGLoss(theirs_on[0], theirs_on[1][0], delay_actor=True, loss_function=loss_function)
    theirs.make_value_estimator(gamma=GAMMA)
    # HardUpdate counts the steps between two copies.
    followed = SoftUpdate(theirs, tau=tau) if tau < 1 else HardUpdate(theirs, value_network_update_interval=0)
    return ours, theirs, StaggeredTargetUpdate(ours, tau=tau, period=1), followed


def gradient(value: Tensor, parameters) -> Tensor:
    """All gradients of `value` in one vector, zeros where it has none."""
    wanted = [p for p in parameters if p.requires_grad]
    found = torch.autograd.grad(value, wanted, allow_unused=True, retain_graph=True)
    parts = [torch.zeros_like(p) if g is None else g for g, p in zip(found, wanted, strict=True)]
    return torch.cat([part.flatten() for part in parts])


def critic_gradient(loss, value: Tensor, num_critics: int) -> Tensor:
    """(critics, parameters a critic), whichever way the loss stacks its critics."""
    if isinstance(loss, GraspTD3BCLoss):
        critics = loss.critic_network_params["critics"]
        rows = [gradient(value, critics[str(i)].values(True, True)) for i in range(num_critics)]
        return torch.stack(rows)
    name = "qvalue_network_params" if isinstance(loss, TD3Loss) else "value_network_params"
    parameters = list(getattr(loss, name).values(True, True))
    found = torch.autograd.grad(value, parameters, retain_graph=True)
    return torch.cat([g.reshape(num_critics, -1) for g in found], dim=-1)


def values(loss, batch: TensorDict) -> tuple[Tensor, Tensor]:
    """The actor's and the critics' loss, the latter's random draws from one seed."""
    batch = batch.clone()
    if isinstance(loss, GraspTD3BCLoss):
        actor = loss.actor_loss(batch)["loss_actor_ddpg"]
        torch.manual_seed(7)
        return actor, loss.critic_loss(batch)["loss_qvalue"]
    out = (loss.actor_loss if isinstance(loss, TD3Loss) else loss.loss_actor)(batch)
    torch.manual_seed(7)
    critic = (loss.value_loss if isinstance(loss, TD3Loss) else loss.loss_value)(batch)
    return out[0], critic[0]


def assert_equal(ours, theirs, batch: TensorDict, num_critics: int, factor: float) -> None:
    (actor, critic), (their_actor, their_critic) = values(ours, batch), values(theirs, batch)
    close = {"rtol": 1e-6, "atol": 1e-6}
    torch.testing.assert_close(actor, their_actor, **close)
    torch.testing.assert_close(factor * critic, their_critic, **close)
    torch.testing.assert_close(
        gradient(actor, ours.actor_network_params.values(True, True)),
        gradient(their_actor, theirs.actor_network_params.values(True, True)),
        **close,
    )
    torch.testing.assert_close(
        factor * critic_gradient(ours, critic, num_critics),
        critic_gradient(theirs, their_critic, num_critics),
        **close,
    )


# Eq. (3) has 1/2: smooth_l1 has it too while errors are below 1, and l2 has not.
HALVES = pytest.mark.parametrize(("loss_function", "factor"), [("smooth_l1", 1.0), ("l2", 2.0)])


@HALVES
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("noise", "bound"), [(0.0, 1.0), (0.2, 1.0), (0.2, 2.5)])
def test_td3(shape, noise, bound, loss_function, factor):
    """Both draw one number a component from the same seed: ours in half ranges, theirs in actions."""
    ours, theirs, *_ = pair(TD3Loss, num_critics=2, noise=noise, bound=bound, loss_function=loss_function)
    assert_equal(ours, theirs, make_batch(*shape), 2, factor)


@HALVES
@pytest.mark.parametrize("shape", SHAPES)
def test_ddpg(shape, loss_function, factor):
    ours, theirs, *_ = pair(DDPGLoss, num_critics=1, loss_function=loss_function)
    assert_equal(ours, theirs, make_batch(*shape), 1, factor)


def test_the_errors_are_small_enough_for_the_comparison():
    ours, *_ = pair(TD3Loss, num_critics=2, loss_function="smooth_l1")
    batch = make_batch(4, 3)
    ours.critic_loss(batch)
    assert 0.05 < batch["td_error"].max() < 1.0


def test_priorities_are_roots_of_theirs():
    """TorchRL's priority is the largest squared error, ours the largest error."""
    ours, theirs, *_ = pair(TD3Loss, num_critics=2, loss_function="l2")
    mine, other = make_batch(8), make_batch(8)
    ours(mine)
    theirs(other)
    torch.testing.assert_close(mine["td_error"].square(), other["td_error"])


@HALVES
@pytest.mark.parametrize(("kind", "num_critics"), [(TD3Loss, 2), (DDPGLoss, 1)])
def test_training_side_by_side(kind, num_critics, loss_function, factor):
    """Ten updates by gradient descent: equal losses and gradients all the way.

    At tau=1 and period=1 soft updates and hard copies are the same.
    """
    ours, theirs, staggered, soft = pair(kind, num_critics=num_critics, loss_function=loss_function)
    for seed in range(10):
        batch = make_batch(8)
        batch["action"] = (batch["action"] + 0.1 * seed).clamp(-1, 1)
        for loss, scale in ((ours, factor), (theirs, 1.0)):
            actor, critic = values(loss, batch)
            parameters = [p for p in loss.parameters() if p.requires_grad]
            loss.zero_grad()
            (actor + scale * critic).backward()
            with torch.no_grad():
                for parameter in parameters:
                    parameter -= 0.05 * parameter.grad
        staggered.step()
        soft.step()
        assert_equal(ours, theirs, batch, num_critics, factor)


def test_soft_targets_follow_as_soft_update_does():
    """Where all targets follow softly, as those of one critic do, losses are equal after each step too."""
    ours, theirs, staggered, soft = pair(DDPGLoss, num_critics=1, loss_function="l2", tau=0.25)
    for _ in range(5):
        grow(ours, theirs)
        staggered.step()
        soft.step()
        assert_same(ours.target_actor_network_params, theirs.target_actor_network_params)
        assert_same(ours.target_critic_network_params["critics", "0"], theirs.target_value_network_params)
        assert_equal(ours, theirs, make_batch(8), 1, 2.0)


def test_the_first_of_two_targets_follows_and_the_second_is_copied():
    ours, theirs, staggered, soft = pair(TD3Loss, num_critics=2, loss_function="l2", tau=0.25)
    for _ in range(5):
        grow(ours, theirs)
        staggered.step()
        soft.step()
        first, second = (ours.target_critic_network_params["critics", str(i)] for i in range(2))
        assert_same(first, theirs.target_qvalue_network_params[0])
        assert_same(second, theirs.qvalue_network_params[1])


def grow(*losses) -> None:
    """Change what the targets follow, alike in each loss."""
    with torch.no_grad():
        for parameter in (p for loss in losses for p in loss.parameters() if p.requires_grad):
            parameter.mul_(1.1)


def assert_same(mine, other) -> None:
    for a, b in zip(mine.values(True, True), other.values(True, True), strict=True):
        torch.testing.assert_close(a.data, b.data, rtol=1e-6, atol=1e-6)


def test_full_imitation_is_pose_bc():
    """λ = 1: values and gradients of PoseBCLoss, whatever the critic says."""
    torch.manual_seed(0)
    actor = Actor(MLP(3, 6, num_cells=[8]), in_keys=["observation"])
    critic = ValueOperator(MLP(9, 1, num_cells=[8]), in_keys=["observation", "action"])
    both = GraspTD3BCLoss(
        actor, [critic, deepcopy(critic)], bc_weight=1.0, aux_weight=0.0, action_bound=ACTION_BOUND
    )
    StaggeredTargetUpdate(both)
    alone = PoseBCLoss(actor)
    for shape in SHAPES:
        batch = make_batch(*shape)
        batch["expert_action"] = 0.1 * torch.randn(*shape, 6)
        batch["has_expert"] = torch.rand(*shape, 1) < 0.7
        parameters = list(actor.parameters())
        expected = alone(batch)["loss_bc"]
        for _ in range(2):
            found = both.actor_loss(batch)
            assert list(found.keys()) == ["loss_actor_bc"]
            torch.testing.assert_close(found["loss_actor_bc"], expected, rtol=1e-6, atol=1e-6)
            torch.testing.assert_close(
                gradient(found["loss_actor_bc"], parameters), gradient(expected, parameters)
            )
            with torch.no_grad():
                for parameter in critic.parameters():
                    parameter.fill_(torch.nan)  # whatever the critic says
