"""Batches, and networks whose outputs can be dictated: real modules, one parameter an output."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class Constant(nn.Module):
    """Writes its parameters, whatever it reads, one row a sample."""

    def __init__(self, *outputs):
        super().__init__()
        self.outputs = nn.ParameterList(torch.tensor(output) for output in outputs)

    def forward(self, *inputs):
        rows = [output.expand(*inputs[0].shape[:-1], -1) for output in self.outputs]
        return rows[0] if len(rows) == 1 else tuple(rows)


@pytest.fixture
def constant_actor():
    def make(action=(0.0,) * 6, goal=REST):
        outputs = {"action": action, "goal_prediction": goal}
        kept = {key: value for key, value in outputs.items() if value is not None}
        return TensorDictModule(Constant(*kept.values()), in_keys=["time_left"], out_keys=list(kept))

    return make


@pytest.fixture
def constant_critic():
    def make(values=(0.0, 0.0), goal=REST):
        outputs = {"state_action_value": values, "goal_prediction": goal}
        kept = {key: value for key, value in outputs.items() if value is not None}
        return TensorDictModule(
            Constant(*kept.values()), in_keys=["time_left", "action"], out_keys=list(kept)
        )

    return make


@pytest.fixture
def batch():
    """Four samples: labels 1, 2, 3 and 4 cm ahead of the resting hand, goals twice as far."""
    ahead = torch.arange(1, 5)[:, None] * 0.01
    return TensorDict(
        {
            "time_left": torch.linspace(1, 0, 4)[:, None],
            "action": torch.zeros(4, 6),
            "expert_action": torch.cat((ahead, torch.zeros(4, 5)), dim=-1),
            "has_expert": torch.tensor([[True], [True], [False], [False]]),
            "goal": torch.cat((2 * ahead, torch.zeros(4, 5), torch.ones(4, 1)), dim=-1),
            "has_goal": torch.tensor([[True], [False], [True], [False]]),
            "episode_success": torch.tensor([[True], [True], [False], [False]]),
            "perturbed": torch.tensor([[False], [False], [False], [True]]),
            "next": {
                "time_left": torch.zeros(4, 1),
                "reward": torch.tensor([[0.0], [0.0], [1.0], [0.0]]),
                "terminated": torch.tensor([[False], [False], [True], [False]]),
                "done": torch.tensor([[False], [False], [True], [False]]),
            },
        },
        [4],
    )
