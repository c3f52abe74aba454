"""Small networks, losses and batches for learners."""

import torch
from tensordict import TensorDict

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic, PointNet
from torchgrasp.objectives import GoalAuxLoss, GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.training import Acceleration, ActorCriticLearner, ImitationLearner


def small_encoder(in_channels: int) -> PointNet:
    return PointNet(in_channels, width=0.25)


def make_optimizers(networks: dict) -> dict:
    return {name: torch.optim.Adam(each.parameters(), lr=1e-3) for name, each in networks.items()}


def make_imitation_learner(*, goal_input: bool = False, seed: int = 0) -> ImitationLearner:
    torch.manual_seed(seed)
    networks: dict = {"actor": GraspActor(small_encoder, goal_input=goal_input)}
    grasp_prediction = None
    if goal_input:
        networks["goal_network"] = GoalPredictor(small_encoder)
        grasp_prediction = GoalAuxLoss(networks["goal_network"])
        grasp_prediction.set_keys(goal_prediction="goal")
    return ImitationLearner(
        networks,
        imitation=PoseBCLoss(networks["actor"]),
        optimizers=make_optimizers(networks),
        grasp_prediction=grasp_prediction,
    )


def make_actor_critic(
    *, policy_delay: int = 2, seed: int = 0, acceleration: Acceleration | None = None
) -> ActorCriticLearner:
    torch.manual_seed(seed)
    acceleration = acceleration or Acceleration()
    networks = {"actor": GraspActor(small_encoder), "critic": GraspCritic(small_encoder)}
    networks = {name: each.to(acceleration.device) for name, each in networks.items()}
    loss = GraspTD3BCLoss(networks["actor"], networks["critic"], action_bound=ACTION_BOUND)
    loss = loss.to(acceleration.device)
    loss.make_value_estimator(gamma=0.9)
    return ActorCriticLearner(
        networks,
        loss=loss,
        targets=StaggeredTargetUpdate(loss, tau=0.5, period=3),
        imitation=PoseBCLoss(networks["actor"]),
        optimizers={name: acceleration.make_adam(each.parameters()) for name, each in networks.items()},
        policy_delay=policy_delay,
        acceleration=acceleration,
    )


def make_batch(size: int = 4, *, seed: int = 0) -> TensorDict:
    """Transitions (B) of 16 points, all of them labelled, of episodes that succeed."""
    generator = torch.Generator().manual_seed(seed)
    true = torch.ones(size, 1, dtype=torch.bool)

    def state() -> dict:
        goal = torch.nn.functional.normalize(torch.rand(size, 7, generator=generator), dim=-1)
        points = torch.rand(size, 16, 4, generator=generator)
        return {"points": points, "time_left": torch.rand(size, 1, generator=generator), "goal": goal}

    ended = {"reward": torch.ones(size, 1), "done": ~true, "terminated": ~true}
    acted = {"action": 0.01 * torch.rand(size, 6, generator=generator)}
    labels = {"expert_action": 0.01 * torch.rand(size, 6, generator=generator)}
    flags = {"has_expert": true, "has_goal": true, "perturbed": ~true, "episode_success": true}
    return TensorDict({**state(), **acted, **labels, **flags, "next": {**state(), **ended}}, [size])


def weights(network: torch.nn.Module) -> torch.Tensor:
    return torch.cat([parameter.detach().flatten().clone() for parameter in network.parameters()])
