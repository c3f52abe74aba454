"""Draws made ahead are those that would have been made on demand, whatever comes between."""

import threading
import time

import pytest
import torch

from torchgrasp.data.drawn_ahead import DrawnAhead


def make(count: int = 12, *, depth: int = 3) -> tuple[torch.Generator, DrawnAhead[int]]:
    generator = torch.Generator().manual_seed(0)
    draw = lambda: int(torch.randint(10**6, (), generator=generator))  # noqa: E731
    return generator, DrawnAhead(draw, generator, count=count, depth=depth)


def draw_on_demand(count: int) -> tuple[list[int], torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    drawn = [int(torch.randint(10**6, (), generator=generator)) for _ in range(count)]
    return drawn, generator.get_state()


@pytest.mark.parametrize("pauses", [(), (0,), (1, 5, 6), tuple(range(12))])
def test_order_and_numbers_are_those_of_draws_on_demand(pauses):
    expected, end = draw_on_demand(12)
    generator, ahead = make()
    found = []
    for number in range(12):
        if number in pauses:
            ahead.pause()
        found.append(next(ahead))
    assert found == expected and list(ahead) == [] and torch.equal(generator.get_state(), end)


def test_a_pause_leaves_the_generator_where_the_draws_taken_left_it():
    generator, ahead = make()
    for taken in (1, 2, 3):
        next(ahead)
        while len(ahead._ready) < 3:  # as many as it may
            time.sleep(0.001)
        ahead.pause()
        assert torch.equal(generator.get_state(), draw_on_demand(taken)[1])


def test_no_more_than_its_depth_are_drawn_ahead():
    _, ahead = make(depth=2)
    next(ahead)
    while len(ahead._ready) < 2:
        time.sleep(0.001)
    time.sleep(0.05)
    assert len(ahead._ready) == 2
    ahead.close()
    assert list(ahead) == []


def test_what_goes_wrong_in_the_thread_is_raised_where_the_draw_is_wanted():
    generator, before = torch.Generator(), threading.active_count()

    def draw() -> int:
        raise ValueError("nothing to draw")

    ahead = DrawnAhead(draw, generator, count=3)
    with pytest.raises(ValueError, match="nothing to draw"):
        next(ahead)
    assert list(ahead) == [] and threading.active_count() == before
