import random

import torch

from torchgrasp.data.index_pool import IndexPool


def test_pool_is_a_set_under_any_sequence_of_changes():
    rng, pool, reference = random.Random(0), IndexPool(), set()
    for _ in range(300):
        rows = rng.sample(range(5000), rng.randint(1, 60))
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
