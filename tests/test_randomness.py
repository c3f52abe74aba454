import zlib

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from torchgrasp.errors import ConfigError
from torchgrasp.randomness import MomentGenerators


def generators(seed):
    return MomentGenerators(seed, purpose="test")


def moments(worlds, episodes, time_left) -> TensorDict:
    n = len(worlds)
    return TensorDict(
        {
            "world": torch.tensor(worlds)[:, None],
            "episode": torch.tensor(episodes)[:, None],
            "time_left": torch.tensor(time_left)[:, None],
        },
        [n],
    )


def draws(generators: MomentGenerators, tensordict: TensorDict) -> list[float]:
    return [rng.random() for rng in generators(tensordict)]


def test_a_draw_follows_from_its_moment_alone():
    batch = moments([0, 1, 2], [5, 5, 6], [1.0, 0.5, 0.5])
    first = draws(generators(3), batch)
    again = generators(3)
    for _ in range(4):  # what was drawn before leaves no trace
        draws(again, moments([9], [9], [0.2]))
    assert draws(again, batch[[2, 0]]) == [first[2], first[0]]


def test_seed_world_episode_and_time_each_tell_draws_apart():
    base = ([1], [2], [0.5])
    others = [([2], [2], [0.5]), ([1], [3], [0.5]), ([1], [2], [0.4]), ([2], [1], [0.5])]
    values = [
        draws(generators(0), moments(*base))[0],
        draws(generators(1), moments(*base))[0],
    ]
    values += [draws(generators(0), moments(*other))[0] for other in others]
    assert len(set(values)) == len(values)


def test_the_steps_of_a_long_episode_differ():
    steps = [1 - t / 300 for t in range(300)]
    assert len(set(draws(generators(0), moments([0] * 300, [0] * 300, steps)))) == 300


def test_time_left_of_two_precisions_names_one_moment():
    low = moments([0], [0], [1 / 3])
    high = low.clone().set("time_left", torch.tensor([[1 / 3]], dtype=torch.float64))
    assert draws(generators(0), low) == draws(generators(0), high)


def test_without_a_moment_calls_and_rows_differ_and_repeat_from_the_start():
    empty = TensorDict({}, [4])
    several = generators(0)
    values = draws(several, empty) + draws(several, empty)
    assert len(set(values)) == 8
    again = generators(0)
    assert draws(again, empty) + draws(again, empty) == values


def test_a_batch_of_any_shape_has_a_generator_an_element():
    grid = moments([0, 1, 2, 3], [0] * 4, [1.0] * 4)
    assert draws(generators(0), grid.reshape(2, 2)) == draws(generators(0), grid)
    assert draws(generators(0), grid[1]) == draws(generators(0), grid)[1:2]


def test_two_purposes_share_no_numbers():
    moment = moments([1], [2], [0.5])
    assert draws(MomentGenerators(0, purpose="noise"), moment) != draws(generators(0), moment)


def test_a_negative_seed_is_refused():
    with pytest.raises(ConfigError, match="seed=-1"):
        MomentGenerators(-1, purpose="test")


@pytest.mark.parametrize("seed", [0, 7, 2**32 + 5, 2**70])
def test_numbers_are_those_of_numpys_own_seeding(seed):
    moment = moments([3], [4], [0.25])
    expected = np.random.default_rng((seed, zlib.crc32(b"test"), 3, 4, 250_000)).random()
    assert draws(generators(seed), moment) == [expected]


def test_what_is_drawn_per_episode_is_the_same_at_all_its_steps():
    per_episode = MomentGenerators(0, purpose="test", per_episode=True)
    first, again, other = draws(per_episode, moments([1, 1, 1], [2, 2, 3], [1.0, 0.5, 0.5]))
    assert first == again != other


def test_rows_are_drawn_for_alone_as_in_the_whole_batch():
    batch = moments([0, 1, 2], [0, 0, 0], [1.0, 1.0, 1.0])
    whole = draws(generators(0), batch)
    assert [rng.random() for rng in generators(0)(batch, [2, 0])] == [whole[2], whole[0]]
