"""Workers that have no place, or lose it with their machine: the others go on, and nobody waits for ever."""

import threading
import time
import warnings

import pytest
from torchrl.envs import TransformedEnv

from tests.rollouts.test_episode_pools import assert_same, flat
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError, WorkerError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import RandomAction
from torchgrasp.rollouts import worker_pool
from torchgrasp.rollouts.episode_pool import SerialPool
from torchgrasp.rollouts.worker_pool import Worker, WorkerLostError, WorkerPool, answer


def make_env():
    objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
    return TransformedEnv(GraspEnv(1, objects=objects, horizon=2, seed=0))


ENVS = {"env": make_env}


class Machine:
    """Where workers may have a place: it can go, taking along who works there, and come back."""

    def __init__(self, *, away: bool = False, returns_in: float = 1e9) -> None:
        self.here, self.returns_in = threading.Event(), returns_in
        self.fails_at: set[int] = set()
        self.answered: list[tuple[int, int]] = []
        if not away:
            self.here.set()

    def go(self) -> None:
        self.here.clear()
        if self.returns_in < 60:
            threading.Timer(self.returns_in, self.here.set).start()


class Tenant(Worker):
    """Runs episodes in this process while its machine is there."""

    ready = False

    def __init__(self, pool, index, machine):
        self._pool, self._index, self._machine, self._stopped = pool, index, machine, threading.Event()

    def settle(self, is_hopeless):
        while not self._machine.here.wait(0.01):
            if self._stopped.is_set() or is_hopeless():
                raise WorkerLostError(f"Worker {self._index} finds no machine with room")
        self.ready = True

    def run(self, task):
        if not self._machine.here.is_set() or task.number in self._machine.fails_at:
            self._machine.fails_at.discard(task.number)
            self._machine.go()
            raise WorkerLostError(f"Worker {self._index} was lost with its machine", blameless=True)
        self._machine.answered.append((self._index, task.number))
        with self._pool.one_at_a_time:
            return answer(self._pool._runner, task)

    def stop(self):
        self._stopped.set()


class TenantPool(WorkerPool):
    """A machine for each worker."""

    def __init__(self, *homes, **options):
        super().__init__(ENVS, num_workers=len(homes), **options)
        self.homes, self.one_at_a_time = homes, threading.Lock()

    def _start_worker(self, index):
        return Tenant(self, index, self.homes[index])


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    monkeypatch.setattr(worker_pool, "_RETRY_SECONDS", 0.01)


@pytest.fixture(scope="module")
def expected():
    with SerialPool(ENVS) as pool:
        return flat(pool.run("env", RandomAction(seed=4), range(6)))


def test_a_worker_without_a_place_holds_up_no_other(expected):
    homes = Machine(away=True), Machine()
    with TenantPool(*homes) as pool:
        assert_same(flat(pool.run("env", RandomAction(seed=4), range(6))), expected)
        assert not homes[0].answered and len(homes[1].answered) == 6
        homes[0].here.set()
        until = time.monotonic() + 30
        while not homes[0].answered and time.monotonic() < until:
            flat(pool.run("env", RandomAction(seed=4), range(6)))
        assert homes[0].answered


def test_a_machine_that_goes_costs_its_episodes_alone_and_is_used_again(expected):
    homes = Machine(returns_in=0.05), Machine(returns_in=0.05)
    for each in homes:
        each.fails_at = {1, 3}
    with TenantPool(*homes) as pool, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert_same(flat(pool.run("env", RandomAction(seed=4), range(6))), expected)
    told = [str(each.message) for each in caught if "was lost" in str(each.message)]
    assert len(told) >= 2
    assert all("was lost with its machine: another takes its place" in each for each in told)


def test_machines_that_go_are_not_the_episodes_fault(expected):
    """More than three losses over one episode, none of which it caused."""
    homes = [Machine() for _ in range(5)]
    for each in homes[:4]:
        each.fails_at = {0}
    with TenantPool(*homes) as pool, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert_same(flat(pool.run("env", RandomAction(seed=4), [0])), expected[:1])


def test_nobody_waits_for_ever_where_nobody_has_a_place():
    with TenantPool(Machine(away=True), Machine(away=True), patience=0.2) as pool:
        with pytest.raises(WorkerError, match=r"Worker \d finds no machine with room, and no other"):
            flat(pool.run("env", RandomAction(seed=4), range(2)))
        for each in pool.homes:
            each.here.set()
        assert len(flat(pool.run("env", RandomAction(seed=4), range(2)))) == 2


def test_closing_does_not_wait_for_a_place():
    pool = TenantPool(Machine(away=True), Machine(away=True))
    pool.run("env", RandomAction(seed=4), range(2))
    began = time.monotonic()
    pool.close()
    assert time.monotonic() - began < 10


@pytest.mark.parametrize("wait", [0.0, 0.002, 0.02])
def test_a_pool_is_closed_while_workers_look_for_a_place(wait):
    for _ in range(20):
        pool = TenantPool(Machine(away=True), Machine(away=True))
        pool.run("env", RandomAction(seed=4), range(2))
        time.sleep(wait)
        pool.close()
        begun = dict(pool._workers)
        assert all(each._stopped.is_set() for each in begun.values())
        assert not any(each.is_alive() for each in pool._settling.values())


def test_patience_is_a_number_of_seconds():
    with pytest.raises(ConfigError, match=r"^patience=-1"):
        TenantPool(Machine(), patience=-1)
