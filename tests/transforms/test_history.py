"""What transforms remember of an episode belongs to one environment."""

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.transforms import AggregatePoints, DelayObservation


@pytest.mark.parametrize("make", [AggregatePoints, DelayObservation])
def test_a_clone_shares_no_memory(make):
    def state(value: float) -> TensorDict:
        points = torch.full((1, 4, 3), value)
        return TensorDict(
            {
                "points": points,
                "num_points": torch.tensor([[4]]),
                "T_base_ee": torch.eye(4)[None],
                "camera": {"mask": torch.full((1, 2, 2), value > 0)},
            },
            [1],
        )

    first = make()
    first._reset(TensorDict({}, [1]), state(0.0))
    second = first.clone()
    assert type(second) is make and second._memories == []
    second._reset(TensorDict({}, [1]), state(9.0))
    after = first._step(TensorDict({}, [1]), state(0.0))
    assert after["points"].abs().max() == 0.0 and not after["camera", "mask"].any()
