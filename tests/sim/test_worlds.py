"""A batch of worlds of which one becomes unstable: an object of 10^30 kg in the hand breaks both engines."""

import os

import numpy as np
import pytest

from torchgrasp.errors import UnstableError
from torchgrasp.sim import Engine, MujocoEngine, Physics, Placement, SapienEngine, Worlds
from torchgrasp.sim import kinematics as kin

READY = kin.READY_POSTURE
HAND = kin.forward_kinematics(READY[None])[0]
SWINGS = [READY + 0.5, READY - 0.5, READY + 0.5]


@pytest.fixture(params=[SapienEngine(), MujocoEngine(substeps=1)], ids=["sapien", "mujoco"])
def engine(request) -> Engine:
    """Each engine in turn, MuJoCo with the fewest steps: with more it bears as much."""
    return request.param


def in_the_hand(target, mass: float) -> Placement:
    pose = HAND.copy()
    pose[:3, 3] = HAND[:3] @ (0.0, 0.0, 0.1, 1.0)
    return Placement(target, pose, READY, Physics(mass=mass))


def make_pair(engine: Engine, target) -> Worlds:
    """A world that breaks, and one that does not."""
    worlds = Worlds(2, engine=engine)
    for row, mass in enumerate((1e30, 0.15)):
        worlds.place(row, in_the_hand(target, mass))
    return worlds


def read(worlds: Worlds, row: int) -> np.ndarray:
    reads = (worlds.joints, worlds.joint_velocities, worlds.T_base_object, worlds.T_base_ee)
    return np.concatenate([each[row].ravel() for each in reads])


def test_a_world_that_breaks_ends_for_itself_alone(engine, brick, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    worlds, alone = make_pair(engine, brick), Worlds(1, engine=engine)
    alone.place(0, in_the_hand(brick, 0.15))
    before = read(worlds, 0)
    for q in SWINGS:
        was_stable = not worlds.unstable[0]
        worlds.drive(np.stack((q, q)), [0, 1])
        alone.drive(q[None], [0])
        if was_stable and worlds.unstable[0]:
            assert np.array_equal(read(worlds, 0), before)
        before = read(worlds, 0)
    risen = worlds.close_and_lift([0, 1])
    assert worlds.unstable.tolist() == [True, False]
    assert np.isnan(risen[0]) and risen[1] == alone.close_and_lift([0])[0]
    assert np.array_equal(read(worlds, 0), before) and np.isfinite(before).all()
    assert np.array_equal(read(worlds, 1), read(alone, 0))
    # MuJoCo neither prints nor writes of it.
    assert not os.listdir(tmp_path) and "unstable" not in "".join(capfd.readouterr())


def test_the_next_episode_begins_as_if_nothing_had_been(engine, brick):
    worlds, fresh = make_pair(engine, brick), Worlds(1, engine=engine)
    for q in SWINGS:
        worlds.drive(q[None], [0])
    assert worlds.unstable[0]
    for each in (worlds, fresh):
        each.place(0, in_the_hand(brick, 0.15))
        each.drive(SWINGS[0][None], [0])
    assert not worlds.unstable.any()
    assert np.array_equal(read(worlds, 0), read(fresh, 0))


def test_what_breaks_a_copy_lifts_nothing(engine, brick):
    worlds = make_pair(engine, brick)
    risen = worlds.try_last(0, np.stack(SWINGS[:2]))
    assert not (risen > 0.0).any() and np.isnan(risen).any()
    assert not worlds.unstable.any()


def test_a_world_by_itself_says_so(engine, brick):
    world = engine.build(in_the_hand(brick, 1e30))
    with pytest.raises(UnstableError, match="became unstable with brick: raise"):
        for q in SWINGS:
            world.drive(q)
