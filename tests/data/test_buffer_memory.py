"""What a buffer takes, told before it takes it."""

import re

import pytest
import torch
from tensordict import TensorDictBase

from tests.data.rollouts import make_rollout, make_steps
from torchgrasp.data import CompactTransitions, MixtureReplayBuffer, Priority, estimate_bytes
from torchgrasp.data.buffer_memory import available_memory, check_space, count_row_bytes
from torchgrasp.errors import ConfigError


def make_buffer(capacities, **options):
    shares = dict.fromkeys(capacities, 1.0 / len(capacities))
    return MixtureReplayBuffer(capacities, shares, batch_size=64, **options)


def make_cloud_steps(num_points: int):
    """(1, 30) steps of one episode, which needs no stub, and their clouds."""
    steps = torch.arange(30)[None]
    done = steps == 29
    rollout = make_steps(steps, done, torch.zeros_like(done), torch.Generator())
    cloud = torch.cat((torch.rand(1, 30, num_points, 4), rollout["points"][..., -6:, :]), dim=-2)
    rollout["points"] = rollout["next", "points"] = cloud
    return rollout, cloud


def find_tensors(held, seen=()):
    """Every tensor that an object of this project holds, however deep."""
    if isinstance(held, torch.Tensor):
        yield held
    elif isinstance(held, TensorDictBase):
        yield from held.values(True, True)
    elif isinstance(held, dict | list | tuple):
        for each in held.values() if isinstance(held, dict) else held:
            yield from find_tensors(each, seen)
    elif id(held) not in seen and type(held).__module__.startswith(("torchgrasp", "torchrl.data")):
        yield from find_tensors(vars(held), (*seen, id(held)))


def count_held(buffer) -> int:
    """Bytes of all memory that the buffer's storage and sampler hold."""
    blocks = (each.untyped_storage() for each in find_tensors([buffer.storage, buffer.sampler]))
    return sum({block.data_ptr(): block.nbytes() for block in blocks}.values())


def test_a_step_of_1024_points_takes_less_than_7_kilobytes():
    rollout, cloud = make_cloud_steps(1024)
    buffer = make_buffer({"online": 30, "expert": 1})
    buffer.extend(rollout)
    assert buffer.num_bytes() == estimate_bytes(30)
    assert estimate_bytes(1) <= 7000
    assert estimate_bytes(2_000_000) < 14e9
    # Coordinates below 1 m keep 11 bits: half of 2^-11 m.
    assert (buffer[:]["points"][..., :3] - cloud[0, ..., :3]).abs().max() <= 2**-12


@pytest.mark.parametrize("num_points", [8, 100])
def test_the_estimate_holds_with_a_priority_and_for_other_clouds(num_points):
    rollout, _ = make_cloud_steps(num_points)
    buffer = make_buffer({"online": 30}, priority=Priority())
    assert buffer.num_bytes() == 0
    buffer.extend(rollout)
    assert buffer.num_bytes() == estimate_bytes(30, num_points=num_points, prioritised=True)


@pytest.mark.parametrize("priority", [None, Priority()])
@pytest.mark.parametrize("capacities", [{"online": 3000}, {"online": 3000, "expert": 1700, "failed": 2300}])
def test_a_buffer_holds_what_was_estimated_and_no_more(capacities, priority):
    buffer = make_buffer(capacities, priority=priority)
    rollout, _ = make_cloud_steps(1)
    for source in capacities:
        buffer.extend(rollout, source=source)
    estimate = estimate_bytes(sum(capacities.values()), num_points=1, prioritised=priority is not None)
    held = count_held(buffer)
    # Beside it are the indices of the last write and the journal, of 16 kB whatever the rows are; a row's
    # share of the sums is rounded up to a byte. What the sampler knows of other writers is 16 bytes.
    assert 0.99 * estimate < held < estimate + 1100 + (1 + 1024) * 2 * 8
    for source, capacity in capacities.items():
        for _ in range(capacity // 30 + 1):
            buffer.extend(rollout, source=source)
    assert len(buffer) == sum(capacities.values())
    assert count_held(buffer) == held


def test_the_estimate_of_pictures_and_goals_is_that_of_the_rows_stored():
    codec = CompactTransitions(points_key=None, image_channels="dm", state_keys=("time_left", "goal"))
    row = codec.example_row({"image": (2, 16, 16), "time_left": (1,), "goal": (7,)})
    rollout = make_rollout(1, 6, generator=torch.Generator().manual_seed(0), done_rate=0.0)
    rollout["next", "goal"] = rollout["goal"]
    rollout["image"] = rollout["next", "image"] = torch.rand(1, 6, 2, 16, 16)
    assert count_row_bytes(codec.encode(rollout)) == count_row_bytes(row)
    # 3 bytes a pixel; 26 floats, 4 int64 and 7 flags.
    assert estimate_bytes(10, row) == 10 * (3 * 256 + 4 * (2 * 6 + 7 + 1 + 1) + 8 * 4 + 7)


def test_a_refusal_says_how_many_transitions_would_fit(tmp_path):
    row_bytes = estimate_bytes(1)
    for folder, where in ((None, "memory"), (tmp_path / "not" / "yet", "disk")):
        with pytest.raises(ConfigError, match=where) as error:
            check_space(10**12, row_bytes, folder=folder)
        (fitting,) = map(int, re.findall(r"(\d+) such transitions would fit", str(error.value)))
        check_space(int(0.9 * fitting), row_bytes, folder=folder)
        with pytest.raises(ConfigError, match="Lower the capacities"):
            check_space(2 * fitting, row_bytes, folder=folder)
        if folder is None:
            assert fitting * row_bytes == pytest.approx(available_memory(), rel=0.2)


def test_a_buffer_that_does_not_fit_is_refused_before_it_takes_memory():
    row = CompactTransitions().example_row({"points": (1030, 4), "time_left": (1,)})
    with pytest.raises(ConfigError, match=f"transitions of {estimate_bytes(1)} bytes"):
        make_buffer({"online": 10**10, "expert": 1}, row=row)
    with pytest.raises(ConfigError, match=f"transitions of {estimate_bytes(1, prioritised=True)} bytes"):
        make_buffer({"online": 10**10, "expert": 1}, row=row, priority=Priority())
    buffer = make_buffer({"online": 10**11, "expert": 1})
    with pytest.raises(ConfigError, match="would fit"):
        buffer.extend(make_rollout(1, 2, generator=torch.Generator()))
