"""The feedback law: from any state, at an even pace, into the grasp."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from torchgrasp.errors import ConfigError
from torchgrasp.planning import Funnel

HORIZON = 30


def random_poses(n: int, *, seed: int, reach: float = 0.4, turn: float = 1.2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-turn, turn, (n, 3))).as_matrix()
    poses[:, :3, 3] = rng.uniform(-reach, reach, (n, 3))
    return poses


def roll_out(funnel: Funnel, start: np.ndarray, goal: np.ndarray, steps: int) -> np.ndarray:
    """(N, steps + 1, 4, 4) poses from start to the closing of the fingers."""
    path = [start]
    for t in range(steps):
        left = np.full(len(start), float(steps - t))
        path.append(funnel.next_pose(path[-1], goal, left, HORIZON))
    return np.stack(path, axis=1)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    relative = np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3]
    return np.arccos(np.clip((np.trace(relative, axis1=-2, axis2=-1) - 1) / 2, -1, 1))


@pytest.fixture(scope="module")
def goals() -> np.ndarray:
    return random_poses(100, seed=1)


@pytest.fixture(scope="module")
def path(goals) -> np.ndarray:
    return roll_out(Funnel(), random_poses(100, seed=0), goals, HORIZON)


def test_every_start_ends_in_the_grasp(path, goals):
    assert np.linalg.norm(path[:, -1, :3, 3] - goals[:, :3, 3], axis=-1).max() < 1.5e-3
    assert angles(path[:, -1], goals).max() < 5e-3


def test_the_hand_turns_first_and_then_arrives(path, goals):
    law = Funnel()
    turned, arrived = (path[:, int(np.ceil(share * HORIZON)) + 1] for share in (law.align, law.arrive))
    assert angles(turned, goals).max() < 0.1
    assert np.linalg.norm(turned[:, :3, 3] - goals[:, :3, 3], axis=-1).max() > 0.05
    assert np.linalg.norm(arrived[:, :3, 3] - goals[:, :3, 3], axis=-1).max() < 0.02


def test_no_step_is_longer_than_an_action_can_be(path):
    move = np.linalg.norm(np.diff(path[..., :3, 3], axis=1), axis=-1)
    turn = angles(path[:, :-1], path[:, 1:])
    assert move.max() < 0.055 + 1e-9 and turn.max() < 0.45 + 1e-9


def test_a_late_hand_still_comes_close(goals):
    start = goals.copy()
    start[:, :3, 3] -= 0.1 * goals[:, :3, 2]
    end = roll_out(Funnel(), start, goals, 4)[:, -1]
    assert np.linalg.norm((end - goals)[:, :3, 3], axis=-1).max() < 0.01


def test_the_way_is_paced_evenly(path):
    move = np.linalg.norm(np.diff(path[:, :27, :3, 3], axis=1), axis=-1)
    assert np.median(move.max(1) / move.mean(1)) < 1.5
    assert np.all(move.max(1) / move.mean(1) < 3.0)


def test_straight_ahead_the_steps_are_equal_until_the_hand_arrives():
    goal = np.eye(4)[None]
    start = goal.copy()
    start[0, 2, 3] = -0.28
    move = np.diff(roll_out(Funnel(), start, goal, HORIZON)[0, :, 2, 3])
    assert move[:24] == pytest.approx(np.full(24, move[0]), abs=1e-9)
    assert move[0] == pytest.approx(0.28 / (Funnel().arrive * HORIZON), rel=0.03)
    assert np.all(move >= 0) and np.all(move[24:] <= move[0] + 1e-9)
    assert move.sum() == pytest.approx(0.28, abs=1e-3)


def test_from_behind_the_last_centimetres_are_straight_along_the_approach(goals):
    rng = np.random.default_rng(2)
    offset = random_poses(100, seed=2, turn=0.5)
    offset[:, :3, 3] = rng.uniform((-0.15, -0.15, -0.4), (0.15, 0.15, -0.2), (100, 3))
    path = roll_out(Funnel(), goals @ offset, goals, HORIZON)
    local = np.linalg.solve(goals[:, None], path)[..., :3, 3]
    assert local[..., 2].max() < 1e-3
    close = local[..., 2] > -0.02
    assert np.linalg.norm(local[..., :2], axis=-1)[close].max() < 0.012


def test_a_misaligned_hand_waits_behind_the_grasp_early_and_hardly_retreats_late():
    goal = np.eye(4)[None]
    beside = goal.copy()
    beside[0, 0, 3] = 0.06  # beside the object, where going straight would knock it over
    early = roll_out(Funnel(), beside, goal, HORIZON)[0, :, 2, 3]
    assert early.min() < -0.03
    late = Funnel().next_pose(beside, goal, np.array([1.0]), HORIZON)
    assert late[0, 2, 3] == pytest.approx(0.0, abs=1e-9)
    three = Funnel().next_pose(beside, goal, np.array([3.0]), HORIZON)
    assert -0.024 <= three[0, 2, 3] <= 0.0


def test_neighbouring_states_get_neighbouring_poses():
    rng = np.random.default_rng(3)
    goal = np.tile(np.eye(4), (500, 1, 1))
    start = random_poses(500, seed=4, reach=0.3)
    nudged = start.copy()
    step = rng.normal(size=(500, 3))
    step *= 1e-4 / np.linalg.norm(step, axis=-1, keepdims=True)
    nudged[:, :3, 3] += step
    for left in (30.0, 15.0, 5.0, 2.0):
        a, b = (Funnel().next_pose(pose, goal, np.full(500, left), HORIZON) for pose in (start, nudged))
        assert np.linalg.norm((a - b)[:, :3, 3], axis=-1).max() < 6e-4
        assert np.abs(a[:, :3, :3] - b[:, :3, :3]).max() < 1e-12  # position does not turn the hand


def test_the_law_is_the_same_wherever_the_robot_stands(goals):
    start = random_poses(100, seed=5)
    elsewhere = random_poses(1, seed=6)[0]
    left = np.full(100, 12.0)
    moved = Funnel().next_pose(elsewhere @ start, elsewhere @ goals, left, HORIZON)
    assert moved == pytest.approx(elsewhere @ Funnel().next_pose(start, goals, left, HORIZON), abs=1e-9)


def test_at_the_grasp_the_hand_stays(goals):
    for left in (30.0, 1.0):
        assert Funnel().next_pose(goals, goals, np.full(100, left), HORIZON) == pytest.approx(goals, abs=1e-7)


def test_rows_do_not_depend_on_their_neighbours(goals):
    start, left = random_poses(100, seed=7), np.arange(1.0, 101.0) % 30 + 1
    together = Funnel().next_pose(start, goals, left, HORIZON)
    for i in range(0, 100, 9):
        row = slice(i, i + 1)
        assert np.array_equal(Funnel().next_pose(start[row], goals[row], left[row], HORIZON), together[row])


@pytest.mark.parametrize("options", [{"arrive": 0.0}, {"align": 1.5}, {"standoff": -0.1}])
def test_impossible_numbers_are_refused(options):
    with pytest.raises(ConfigError, match=f"^{next(iter(options))}="):
        Funnel(**options)
