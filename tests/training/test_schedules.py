"""Schedules in torch's LambdaLR: the rates by hand, and resuming in the middle."""

import pytest
import torch
from torch.optim.lr_scheduler import LambdaLR

from torchgrasp.errors import ConfigError
from torchgrasp.training.schedules import cosine_schedule, step_schedule

SCHEDULES = [
    # Rates of 0.4, halved at steps 3 and 5.
    (lambda: step_schedule([3, 5], gamma=0.5), [0.4, 0.4, 0.4, 0.2, 0.2, 0.1, 0.1]),
    # Half of 0.4, then 0.4 and half a cosine over four steps: cos 45 degrees is 0.70711.
    (
        lambda: cosine_schedule(6, warmup_steps=2),
        [0.2, 0.4, 0.4, 0.2 * 1.7071068, 0.2, 0.2 * 0.2928932, 0.0],
    ),
]


def _optimizer():
    torch.manual_seed(0)
    weight = torch.nn.Parameter(torch.ones(3))
    return weight, torch.optim.Adam([weight], lr=0.4)


def _train(weight, optimizer, scheduler, steps):
    rates = []
    for _ in range(steps):
        rates.append(scheduler.get_last_lr()[0])
        optimizer.zero_grad()
        (weight * torch.tensor([1.0, -2.0, 3.0])).square().sum().backward()
        optimizer.step()
        scheduler.step()
    return rates


@pytest.mark.parametrize(("make", "expected"), SCHEDULES)
def test_rates_by_hand(make, expected):
    weight, optimizer = _optimizer()
    assert _train(weight, optimizer, LambdaLR(optimizer, make()), 7) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize(("make", "expected"), SCHEDULES)
@pytest.mark.parametrize("cut", range(1, 7))
def test_a_resumed_run_goes_on_as_if_it_had_not_stopped(make, expected, cut):
    whole, optimizer = _optimizer()
    _train(whole, optimizer, LambdaLR(optimizer, make()), 7)

    weight, optimizer = _optimizer()
    scheduler = LambdaLR(optimizer, make())
    _train(weight, optimizer, scheduler, cut)
    resumed, again = _optimizer()
    resumed.data.copy_(weight.data)
    restarted = LambdaLR(again, make())
    again.load_state_dict(optimizer.state_dict())
    restarted.load_state_dict(scheduler.state_dict())
    assert _train(resumed, again, restarted, 7 - cut) == pytest.approx(expected[cut:], abs=1e-7)
    assert torch.equal(resumed, whole)


def test_groups_keep_their_own_rates():
    """One schedule multiplies 0.4 and 0.04 alike."""
    first, second = (torch.nn.Parameter(torch.ones(1)) for _ in range(2))
    optimizer = torch.optim.SGD([{"params": [first], "lr": 0.4}, {"params": [second], "lr": 0.04}])
    scheduler = LambdaLR(optimizer, step_schedule([1], gamma=0.5))
    optimizer.step()
    scheduler.step()
    assert scheduler.get_last_lr() == pytest.approx([0.2, 0.02])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"milestones": [5, 3]}, r"^milestones=\[5, 3\] must increase"),
        ({"milestones": [3, 3]}, "^milestones"),
        ({"milestones": [3], "gamma": 0.0}, "^gamma=0.0"),
        ({"milestones": [3], "gamma": float("nan")}, "^gamma=nan"),
    ],
)
def test_an_error_names_the_one_value_that_is_wrong(options, message):
    with pytest.raises(ConfigError, match=message):
        step_schedule(**options)
