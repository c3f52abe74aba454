"""The 16 cells of Table 2: the goal as input and as prediction, for the actor and for the critic."""

from functools import partial
from itertools import product

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic, PointNet
from torchgrasp.objectives import GoalAuxLoss, GraspTD3BCLoss

SMALL = partial(PointNet, out_features=16, hidden=(8, 16))
BASE_TERMS = {"loss_qvalue", "loss_actor_bc", "loss_actor_ddpg"}


def make_batch(size=6):
    generator = torch.Generator().manual_seed(0)

    def state():
        turn = torch.nn.functional.normalize(torch.rand(size, 4, generator=generator), dim=-1)
        goal = torch.cat((0.1 * torch.rand(size, 3, generator=generator), turn), dim=-1)
        points = 0.1 * torch.rand(size, 20, 4, generator=generator)
        return {"points": points, "time_left": torch.rand(size, 1, generator=generator), "goal": goal}

    end = torch.arange(size)[:, None] % 3 == 0
    ends = {"reward": end.float(), "terminated": end, "done": end}
    labels = {"action": torch.zeros(size, 6), "expert_action": torch.full((size, 6), 0.01)}
    return TensorDict({**state(), **labels, "next": {**state(), **ends}}, [size])


@pytest.mark.parametrize(
    ("actor_reads", "actor_predicts", "critic_reads", "critic_predicts"), [*product([False, True], repeat=4)]
)
def test_every_cell_trains(actor_reads, actor_predicts, critic_reads, critic_predicts):
    actor = GraspActor(SMALL, goal_input=actor_reads, goal_prediction=actor_predicts)
    critic = GraspCritic(SMALL, goal_input=critic_reads, goal_prediction=critic_predicts)
    loss, batch = GraspTD3BCLoss(actor, critic, action_bound=ACTION_BOUND), make_batch()
    assert (("next", "goal") in loss.in_keys) is (actor_reads or critic_reads)
    out = loss(batch).to_dict()
    terms = {key for key in out if key.startswith("loss_")}
    auxiliary = {"loss_actor_aux": actor_predicts, "loss_critic_aux": critic_predicts}
    assert terms == BASE_TERMS | {key for key, present in auxiliary.items() if present}
    assert all(out[key].isfinite() for key in out)
    parameters = [*actor.parameters(), *critic.parameters()]
    optimizer = torch.optim.SGD(parameters, lr=0.1)
    before = [parameter.clone() for parameter in parameters]
    sum(out[key] for key in terms).backward()
    optimizer.step()
    moved = [not torch.equal(new, old) for new, old in zip(parameters, before, strict=True)]
    assert all(moved)


@pytest.mark.parametrize("reader", ["actor", "critic"])
def test_the_target_reads_the_goal_of_the_next_state(reader):
    """Eq. (3): y depends on the next goal where a network reads it, and on no other."""
    reads = {name: name == reader for name in ("actor", "critic")}
    actor = GraspActor(SMALL, goal_input=reads["actor"])
    critic = GraspCritic(SMALL, goal_input=reads["critic"])
    for network in (actor, critic):
        for name, parameter in network.named_parameters():
            parameter.data = torch.randn_like(parameter) if "head" in name else parameter.data
    loss, batch = GraspTD3BCLoss(actor, critic, action_bound=ACTION_BOUND, policy_noise=0.0), make_batch()
    moved = batch.clone().set("goal", -batch["goal"])
    later = batch.clone()
    later["next", "goal"] = -batch["next", "goal"]
    y = [loss.critic_loss(each)["target_value"] for each in (batch, moved, later)]
    assert y[0] == y[1] and y[0] != y[2]


def test_a_goal_network_learns_from_labels():
    """Table 5, Goal-Conditioned: trained for grasp prediction alone; has_goal chooses the samples."""
    network, batch = GoalPredictor(SMALL), make_batch()
    loss = GoalAuxLoss(network)
    loss.set_keys(goal_prediction="goal")
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    start = loss(batch)["loss_aux"].item()
    for _ in range(60):
        optimizer.zero_grad()
        loss(batch)["loss_aux"].backward()
        optimizer.step()
    assert loss(batch)["loss_aux"] < 0.7 * start
    absent = batch.clone().set("has_goal", torch.zeros(6, 1, dtype=torch.bool))
    assert loss(absent)["loss_aux"] == 0
