"""The length of a run's main phase, by hand."""

import pytest

from torchgrasp.config.main_phase import MainPhase, count_rounds, describe_idle_workers


@pytest.mark.parametrize(("episodes", "num_envs", "rounds"), [(14, 7, 2), (14, 1, 14), (15, 7, 3), (2, 7, 1)])
def test_rounds_give_an_iteration_its_episodes(composed, episodes, num_envs, rounds):
    assert count_rounds(composed(f"collector.episodes={episodes}", f"env.num_envs={num_envs}")) == rounds


@pytest.mark.parametrize(
    ("workers", "worlds", "remedy"),
    [
        (3, 7, "env.num_envs=2 makes 7 groups"),
        (8, 7, "env.num_envs=1 makes 14"),
        (15, 7, "env.num_envs=1 makes 14"),
    ],
)
def test_workers_without_a_group_of_worlds_are_told_of(composed, workers, worlds, remedy):
    told = describe_idle_workers(composed(f"collector.num_workers={workers}", f"env.num_envs={worlds}"))
    assert told is not None and "no more than 2 can be busy" in told and remedy in told


def test_workers_that_all_have_work_are_not(composed):
    assert describe_idle_workers(composed("collector.num_workers=2")) is None
    assert describe_idle_workers(composed("collector.num_workers=0")) is None
    told = describe_idle_workers(composed("collector.num_workers=15", "env.num_envs=1"))
    assert told is not None and told.endswith("no more than 14 can be busy at once.")


def test_offline_makes_as_many_updates_as_its_steps_would(composed):
    """33,600 steps of 30, 14 episodes an iteration: 80 times 40 updates; 3 M steps: 7143 times 20."""
    assert MainPhase.of(composed("experiment=laptop", "offline.updates=auto")).length == 80 * 40
    paper = composed("experiment=paper", "offline.updates=auto")
    assert MainPhase.of(paper).length == 7143 * 20 and MainPhase.of(paper).unit == "update"


def test_online_is_measured_in_steps():
    phase = MainPhase(total_env_steps=100, offline_updates=0, updates=20)
    assert (phase.length, phase.unit, phase.position(3, 60)) == (100, "step", 60)
    assert [phase.progress(9, steps) for steps in (0, 25, 120)] == [0.0, 0.25, 1.2]
    assert phase.updates_ahead(1000) == 20


def test_offline_ends_with_its_last_update():
    phase = MainPhase(total_env_steps=0, offline_updates=50, updates=20)
    assert [phase.position(iteration, 0) for iteration in range(4)] == [0, 20, 40, 50]
    assert [phase.updates_ahead(iteration) for iteration in range(3)] == [20, 20, 10]


def test_a_phase_without_length_is_over():
    assert MainPhase(total_env_steps=0, offline_updates=0, updates=20).progress(0, 0) == 1.0
