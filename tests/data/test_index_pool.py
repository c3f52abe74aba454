import random

import pytest
import torch

from torchgrasp.data.index_pool import IndexPool
from torchgrasp.data.priorities import PriorityPool
from torchgrasp.errors import ConfigError


@pytest.mark.parametrize("span", [None, range(5000), range(700, 5700)])
def test_pool_is_a_set_under_any_sequence_of_changes(span):
    rng, pool, reference = random.Random(0), IndexPool(span), set()
    for _ in range(300):
        rows = rng.sample(span or range(5000), rng.randint(1, 60))
        if rng.random() < 0.55:
            pool.add(torch.tensor(rows))
            reference |= set(rows)
        else:
            pool.remove(torch.tensor(rows))
            reference -= set(rows)
        assert set(pool.members.tolist()) == reference
        assert len(pool) == len(reference)


def test_draws_are_uniform_and_follow_the_generator():
    pool = IndexPool()
    pool.add(torch.arange(0, 40, 4))
    draws = pool.draw(20_000, torch.Generator().manual_seed(0))
    counts = torch.bincount(draws, minlength=40)[::4]
    assert counts.sum() == 20_000
    assert (counts - 2000).abs().max() < 5 * 2000**0.5
    assert torch.equal(draws, pool.draw(20_000, torch.Generator().manual_seed(0)))


def test_rows_of_other_sources_are_passed_over_but_not_taken():
    for make in (IndexPool, PriorityPool):
        pool = make(range(10, 20))
        pool.remove(torch.tensor([0, 9, 15, 20, 10**9]))
        pool.add(torch.tensor([10, 19]))
        pool.remove(torch.tensor([0, 9, 15, 20, 10**9]))
        assert pool.members.tolist() == [10, 19]
        for row in (9, 20):
            with pytest.raises(ConfigError, match="span"):
                pool.add(torch.tensor([12, row]))


def test_drawing_nothing_gives_nothing():
    for pool in (IndexPool(), PriorityPool()):
        pool.add(torch.arange(5))
        assert pool.draw(0, None).shape == (0,)
