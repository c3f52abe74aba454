"""A rehearsal that tests share: one scene of a validation object, the pretrained policy, our camera."""

import contextlib
import functools
import time

import torchgrasp
from tests.deploy.pretrained import policy
from torchgrasp.deploy import ClosedLoop, FrankaArm, GraspAgent
from torchgrasp.deploy.rehearsal import Rehearsal, RehearsalCamera
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import RaycastCamera

CAMERA = RaycastCamera()


@functools.cache
def drawn():
    """A target and the scene that GraspEnv draws for it."""
    objects = ProceduralObjects("val", num_objects=3, num_grasps=100)
    env = torchgrasp.make_env(policy(), objects=objects, num_envs=1, seed=0)
    scene = env.base_env.scene(0, 0)
    return objects[scene.object_id], scene


@functools.cache
def agent(period=0.15):
    return GraspAgent(policy(), intrinsics=CAMERA.intrinsics, T_ee_camera=CAMERA.T_ee_camera, period=period)


def rehearse(**options):
    target, scene = drawn()
    return Rehearsal(target, scene.T_base_object, scene.q, **options)


@contextlib.contextmanager
def connected(limits=None, **options):
    """A rehearsal and the arm in it."""
    with (
        rehearse(**options) as rehearsal,
        FrankaArm(rehearsal.host, limits=limits, realtime=False) as arm,
    ):
        yield rehearsal, arm


def make_loop(rehearsal, arm, *, camera=None, limits=None, period=0.15, **options):
    camera = camera or RehearsalCamera(rehearsal, CAMERA)
    # Generous, because tests share a machine: each provokes what it is about.
    options = {"watchdog": 1.0, "max_age": 1.0, "clock": rehearsal.clock} | options
    return ClosedLoop(arm, agent(period), camera, limits=limits, **options)


def wait_for(condition, seconds=30.0):
    """Wait until a condition holds; fails where it does not in time."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.005)
