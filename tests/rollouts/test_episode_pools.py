"""What every pool promises, one process, several, or Ray: the same episodes, in order, whatever dies."""

import functools
import os
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import CancelledError
from itertools import count
from pathlib import Path

import pytest
import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.envs import Compose, TransformedEnv

from tests.warm_python import WarmProcess
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.modules import DecayingUniformNoise
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy, RandomAction
from torchgrasp.rollouts.episode_pool import SerialPool
from torchgrasp.rollouts.process_pool import ProcessPool
from torchgrasp.rollouts.ray_pool import RayPool
from torchgrasp.rollouts.rounds import collect_rounds
from torchgrasp.rollouts.worker_pool import AHEAD
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AggregatePoints, DepthToPoints, SamplePoints

HORIZON = 5
WITH_WORKERS = {"processes": functools.partial(ProcessPool, num_workers=2)}
WITH_WORKERS["ray"] = functools.partial(RayPool, num_workers=2)


def make_objects():
    return ProceduralObjects("train", num_objects=2, num_grasps=100)


def make_env(num_envs: int = 2):
    camera = RaycastCamera(CameraIntrinsics(width=24, height=24))
    env = GraspEnv(num_envs, objects=make_objects(), camera=camera, horizon=HORIZON, seed=0)
    return TransformedEnv(env, Compose(DepthToPoints(), AggregatePoints(), SamplePoints(16)))


ENVS = {"env": make_env, "wide": functools.partial(make_env, 3)}


RAY = pytest.param("ray", marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=["serial", "processes", RAY])
def pool(request):
    """One pool of each kind for all tests of this module that harm none."""
    with {"serial": SerialPool, **WITH_WORKERS}[request.param](ENVS) as made:
        yield made


@pytest.fixture(scope="module")
def alone():
    with SerialPool(ENVS) as made:
        yield made


class Mortal(TensorDictModuleBase):
    """Acts like RandomAction; kills its process at the third step of an episode, `deaths` times in all."""

    in_keys, out_keys = RandomAction().in_keys, ["action"]

    def __init__(self, folder: Path, *, number: int, deaths: int) -> None:
        super().__init__()
        self.folder, self.number, self.deaths = folder, number, deaths
        self.act = RandomAction(seed=4)

    def forward(self, tensordict):
        third = bool(((1 - tensordict["time_left"]) * HORIZON > 1.5).all())
        already = len(list(self.folder.iterdir()))
        if third and int(tensordict["episode"][0]) == self.number and already < self.deaths:
            (self.folder / str(already)).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return self.act(tensordict)


def refuse(tensordict):
    raise ConfigError("this policy does nothing")


def flat(batches):
    return [episode for batch in batches for episode in batch]


def assert_same(ours, theirs):
    names = [[(e.world, e.number, e.object_name, e.failure) for e in each] for each in (ours, theirs)]
    assert names[0] == names[1]
    for one, other in zip(ours, theirs, strict=True):
        assert set(one.steps.keys(True, True)) == set(other.steps.keys(True, True))
        assert (one.steps == other.steps).all()


def test_the_same_episodes_bit_for_bit_whoever_runs_them(pool, alone):
    policy = RandomAction(seed=4)
    ours, theirs = (flat(each.run("env", policy, range(3))) for each in (pool, alone))
    assert [(e.number, e.world) for e in ours] == [(n, w) for n in range(3) for w in range(2)]
    assert_same(ours, theirs)


def test_exploration_is_the_same_too_and_only_where_asked_for(pool, alone):
    expert = ExpertPolicy(make_objects(), horizon=HORIZON)
    policy = TensorDictSequential(expert, DecayingUniformNoise(annealing_steps=10, seed=1))
    plain, explored = (flat(pool.run("env", policy, [0], explore=explore)) for explore in (False, True))
    assert_same(explored, flat(alone.run("env", policy, [0], explore=True)))
    assert not torch.equal(plain[0].steps["action"][0], explored[0].steps["action"][0])


def test_the_time_of_workers_is_counted_and_only_theirs(pool):
    before, started = pool.work_seconds, time.perf_counter()
    flat(pool.run("env", RandomAction(seed=4), range(4)))
    worked, whole = pool.work_seconds - before, time.perf_counter() - started
    assert worked == 0 if isinstance(pool, SerialPool) else 0 < worked <= 2 * whole


def test_an_episode_depends_on_nothing_that_ran_before_it(pool):
    policy = RandomAction(seed=4)
    assert_same(flat(pool.run("env", policy, [1])), flat(pool.run("env", policy, [0, 1]))[2:])


def test_the_number_of_worlds_changes_no_world(pool):
    policy = RandomAction(seed=4)
    narrow, wide = (flat(pool.run(name, policy, range(2))) for name in ("env", "wide"))
    assert [e.world for e in wide] == [0, 1, 2, 0, 1, 2]
    assert_same(narrow, [e for e in wide if e.world < 2])


def test_a_run_that_is_dropped_leaves_the_next_alone(pool, alone):
    policy = RandomAction(seed=4)
    dropped = pool.run("env", policy, range(6))
    next(dropped)
    dropped.close()
    assert_same(flat(pool.run("env", policy, [2])), flat(alone.run("env", policy, [2])))


def test_runs_take_turns(pool, alone):
    """A round of training and an evaluation, handed over alternately."""
    policies = [RandomAction(seed=seed) for seed in (4, 5)]
    runs = [pool.run("env", policy, range(3)) for policy in policies]
    turns = [[next(run) for run in runs] for _ in range(3)]
    for place, policy in enumerate(policies):
        assert_same(flat(turn[place] for turn in turns), flat(alone.run("env", policy, range(3))))


def test_an_error_of_the_policy_is_raised_here_and_ends_nothing(pool):
    with pytest.raises(ConfigError, match="this policy does nothing"):
        flat(pool.run("env", refuse, [0]))
    assert len(flat(pool.run("env", RandomAction(), [0]))) == 2


@pytest.mark.parametrize("overlap", [False, True])
def test_rounds_are_the_same_whoever_collects_them(pool, alone, overlap):
    """The policy moves on from round to round, as by learning; the same one runs each round in every pool."""
    collected = []
    for each in (pool, alone):
        policies = iter([RandomAction(seed=seed) for seed in range(9)])
        options = {"first": 5, "length": 2, "overlap": overlap}
        rounds = collect_rounds(each, "env", lambda _, made=policies: next(made), **options)
        collected.append([next(rounds) for _ in range(3)])
        rounds.close()
    for ours, theirs in zip(*collected, strict=True):
        assert_same(ours, theirs)
    assert [e.number for round_ in collected[0] for e in round_[::2]] == [5, 6, 7, 8, 9, 10]


def test_overlap_is_one_round_stale(alone):
    """What is learned from a round shows in the next one, with overlap in the one after."""
    learned, versions = [0], {}
    for overlap in (False, True):
        made = versions[overlap] = []

        def make_policy(_, made=made):
            made.append(learned[0])
            return RandomAction()

        learned[0] = 0
        rounds = collect_rounds(alone, "env", make_policy, first=0, length=1, overlap=overlap)
        for _ in range(4):
            next(rounds)
            learned[0] += 1
        rounds.close()
    assert versions == {False: [0, 1, 2, 3], True: [0, 0, 1, 2, 3]}


@pytest.mark.parametrize("pool", ["processes", RAY], indirect=True)
class TestDeaths:
    """Workers killed by SIGKILL in the middle of an episode."""

    def test_a_killed_worker_is_named_and_its_episode_run_again(self, pool, alone, tmp_path):
        with pytest.warns(UserWarning, match="takes its place") as caught:
            episodes = flat(pool.run("env", Mortal(tmp_path, number=1, deaths=1), range(3)))
        assert_same(episodes, flat(alone.run("env", RandomAction(seed=4), range(3))))
        (told,) = (str(each.message) for each in caught if "takes its place" in str(each.message))
        assert "process " in told and "episode 1 of the environment 'env'" in told and "\n" not in told
        if isinstance(pool, ProcessPool):
            assert "was killed by SIGKILL, as it happens when memory runs out" in told

    def test_an_episode_that_kills_all_its_workers_is_an_error(self, pool, tmp_path):
        told = r"3 workers died over episode 1 .*lower num_workers"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            batches = pool.run("env", Mortal(tmp_path, number=1, deaths=99), range(3))
            assert len(next(batches)) == 2
            with pytest.raises(TorchgraspError, match=told):
                next(batches)
            assert len(flat(pool.run("env", RandomAction(), [5]))) == 2
        assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("end", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_workers_end_with_who_started_them(tmp_path, end):
    """Killed in a run, or by ctrl-C, which reaches workers too: no orphan, one traceback at most."""
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from test_episode_pools import ENVS, ProcessPool, RandomAction\n"
        "if __name__ == '__main__':\n"
        "    with ProcessPool(ENVS, num_workers=1) as pool:\n"
        "        batches = pool.run('env', RandomAction(), range(10_000))\n"
        "        next(batches)\n"
        "        print('running', flush=True)\n"
        "        list(batches)\n"
    )
    command, pipe = [sys.executable, str(script)], subprocess.PIPE
    with WarmProcess(command, stdout=pipe, stderr=pipe, start_new_session=True) as process:
        assert process.stdout.readline() == "running\n"
        if end == signal.SIGKILL:
            process.kill()
        else:
            os.killpg(process.pid, end)
        _, told = process.communicate(timeout=30)  # until the pipe's end: the workers hold it too
    assert told.count("Traceback") == (end == signal.SIGINT) and told.count("KeyboardInterrupt") <= 1


def test_answers_do_not_pile_up():
    """Numbers are asked for as answers are taken, so that endless ones can be given."""
    asked: list[int] = []

    def numbers():
        for number in count():
            asked.append(number)
            yield number

    with ProcessPool(ENVS, num_workers=1) as pool:
        batches = pool.run("env", RandomAction(), numbers())
        assert len(asked) == AHEAD
        assert [next(batches)[0].number for _ in range(3)] == [0, 1, 2]
        assert len(asked) == AHEAD + 3
        batches.close()


def test_a_closed_pool_keeps_nobody_waiting():
    pool = ProcessPool(ENVS, num_workers=1)
    batches = pool.run("env", RandomAction(), range(3))
    next(batches)
    pool.close()
    with pytest.raises(CancelledError):
        flat(batches)
    with pytest.raises(RuntimeError, match="after shutdown"):
        pool.run("env", RandomAction(), [0])


def test_whole_episodes_with_the_keys_asked_for():
    expert = ExpertPolicy(make_objects(), horizon=HORIZON)
    with SerialPool({"env": make_env}, keep=["points", "action"]) as pool:
        (episode, _) = flat(pool.run("env", expert, [0]))
    assert episode.steps.batch_size == (HORIZON,)
    assert episode.steps["next", "done"].squeeze(-1).tolist() == [False] * (HORIZON - 1) + [True]
    assert set(episode.steps.keys()) == {"points", "action", "next"}


@pytest.mark.parametrize(("kind", "num_workers"), [(ProcessPool, -1), (ProcessPool, 0), (SerialPool, 2)])
def test_bad_number_of_workers(kind, num_workers):
    with pytest.raises(ConfigError, match=f"^num_workers={num_workers}"):
        kind({"env": make_env}, num_workers=num_workers)


def test_a_cluster_that_is_too_small_is_refused():
    with pytest.raises(ConfigError, match=r"num_workers=99 of 1 cores each do not fit the \d+ cores"):
        RayPool(ENVS, num_workers=99, init={"num_cpus": 2})


def test_an_address_where_no_ray_is_is_refused_at_once():
    script = "from torchgrasp.rollouts import RayPool; RayPool({}, num_workers=1, address='127.0.0.1:9')"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=100)
    assert "ConfigError: address=127.0.0.1:9 does not answer" in done.stderr


@pytest.mark.slow
def test_ray_that_is_started_here_listens_to_this_machine_alone_and_ends_at_once():
    """Two workers where there is room for none: they wait for it, and closing does not wait with them."""
    script = """
import time
import psutil
from tests.rollouts.test_episode_pools import ENVS, RandomAction, RayPool

if __name__ == "__main__":
    pool = RayPool(ENVS, num_workers=2, init={"num_cpus": 2})
    @pool._ray.remote(num_cpus=2)
    class Blocker:
        pass
    blocker = Blocker.remote()
    pool._ray.get(blocker.__ray_ready__.remote())
    pool.run("env", RandomAction(), range(2))
    time.sleep(1.0)
    listening = set()
    for process in psutil.Process().children(recursive=True):
        open_ports = [each for each in process.net_connections() if each.status == "LISTEN"]
        listening |= {each.laddr.ip.removeprefix("::ffff:") for each in open_ports}  # as IPv6 has it
    began = time.monotonic()
    pool.close()
    print(listening, time.monotonic() - began < 20)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=100)
    assert done.stdout == "{'127.0.0.1'} True\n", done.stderr
