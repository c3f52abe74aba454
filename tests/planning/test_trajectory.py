"""Goal-set trajectory optimisation and pacing."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.planning.scenes import OBJECTS
from torchgrasp.errors import ConfigError
from torchgrasp.planning import TrajectoryOptimizer
from torchgrasp.planning.clearance import Clearance
from torchgrasp.planning.pacing import effort, pace
from torchgrasp.sim import kinematics as kin

# The arm swings from its right to its left.
START, END = kin.READY_POSTURE.copy(), kin.READY_POSTURE.copy()
START[0], END[0] = -0.9, 0.9
NO_TOLL = np.zeros(1)


def pillar(height: float = 0.26) -> Clearance:
    """A pillar in the middle of the swing, lower than the hand can rise."""
    mesh = trimesh.creation.cylinder(radius=0.05, height=height)
    vertices = mesh.vertices.astype(np.float32)
    item = replace(
        OBJECTS[0],
        vertices=vertices,
        faces=mesh.faces.astype(np.int32),
        parts=(vertices,),
        content_hash=f"pillar {height}",
    )
    pose = np.eye(4)
    pose[:3, 3] = 0.6, 0.0, height / 2
    return Clearance.of(item, pose)


def nowhere() -> Clearance:
    clearance = pillar()
    far = clearance.T_base_object.copy()
    far[0, 3] = 5.0
    return replace(clearance, T_base_object=far)


def test_where_nothing_is_in_the_way_the_path_is_straight():
    order, paths = TrajectoryOptimizer().optimize(nowhere(), START, END[None], NO_TOLL)
    assert order.tolist() == [0]
    assert np.diff(paths[0], n=2, axis=0) == pytest.approx(np.zeros((12, 7)), abs=1e-12)


def test_a_path_bends_around_what_is_in_the_way():
    clearance = pillar()
    order, _ = TrajectoryOptimizer(iterations=0).optimize(clearance, START, END[None], NO_TOLL)
    assert not len(order), "the straight path hits the pillar"
    order, paths = TrajectoryOptimizer().optimize(clearance, START, END[None], NO_TOLL)
    assert order.tolist() == [0]
    assert paths[0, 0] == pytest.approx(START) and paths[0, -1] == pytest.approx(END)
    dense = np.concatenate([np.linspace(a, b, 10) for a, b in zip(paths[0], paths[0, 1:], strict=False)])
    assert clearance.distances(dense).min() > 0.0
    assert (dense >= kin.JOINT_LOWER).all() and (dense <= kin.JOINT_UPPER).all()
    steps = np.linalg.norm(np.diff(paths[0], axis=0), axis=-1)
    assert steps.max() < 3 * steps.mean(), "the path is smooth"


def test_another_goal_is_taken_where_the_near_one_is_behind_something():
    near, far = END.copy(), START.copy()
    far[0] = -2.6
    away = np.linalg.norm([near - START, far - START], axis=-1)
    goals, toll = np.stack((near, far)), np.zeros(2)
    order, _ = TrajectoryOptimizer(iterations=0).optimize(pillar(), START, goals, toll)
    assert order.tolist() == [1]
    order, _ = TrajectoryOptimizer().optimize(nowhere(), START, goals, toll)
    assert order.tolist() == np.argsort(away).tolist()


def test_tolls_decide_between_goals_of_the_same_length():
    left, right = START.copy(), START.copy()
    left[6], right[6] = START[6] - 0.5, START[6] + 0.5
    goals = np.stack((left, right))
    for toll in ([0.0, 0.3], [0.3, 0.0]):
        order, _ = TrajectoryOptimizer().optimize(nowhere(), START, goals, np.array(toll))
        assert order[0] == int(np.argmin(toll))


def test_a_deadline_that_has_passed_ends_the_optimisation():
    order, _ = TrajectoryOptimizer().optimize(pillar(), START, END[None], NO_TOLL, deadline=0.0)
    assert not len(order)


@pytest.mark.parametrize("option", [{"num_points": 0}, {"iterations": -1}, {"keep": 0.0}, {"step": 2.0}])
def test_senseless_options_are_refused(option):
    with pytest.raises(ConfigError, match=f"^{next(iter(option))}="):
        TrajectoryOptimizer(**option)


def test_paced_steps_keep_ends_limits_and_an_even_effort():
    way = np.stack((START, kin.READY_POSTURE, END))
    path = pace(way, 25, 0.15)
    assert path is not None and path.shape == (26, 7)
    assert path[0] == pytest.approx(START) and path[-1] == pytest.approx(END)
    spent = effort(path, 0.15)
    assert spent.max() <= 1.0 and spent.max() < 1.1 * spent.min()


def test_as_few_steps_as_the_limits_allow():
    way = np.stack((START, END))
    path = pace(way, 1, 0.15)
    assert path is not None
    fewest = len(path) - 1
    assert effort(path, 0.15).max() <= 1.0 + 1e-9
    assert pace(way, 1, 0.15, at_most=fewest - 1) is None
    assert pace(way, 1, 0.15, at_most=fewest) == pytest.approx(path)
    assert np.abs(np.diff(path, axis=0)).max() <= 0.15 * kin.JOINT_VELOCITY.max()


def test_a_way_of_no_length_stands_still():
    path = pace(np.stack((START, START)), 4, 0.15)
    assert path == pytest.approx(np.tile(START, (5, 1)))
