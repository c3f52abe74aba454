"""The arm's drives: limits of their force and speed, and an arm that does not tremble."""

import mujoco
import numpy as np
import pytest

from torchgrasp.sim import MujocoEngine, Physics, Placement
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.mujoco.arm_drives import ArmDrives
from torchgrasp.sim.panda_tables import ARM_DAMPING, ARM_STIFFNESS

READY = kin.READY_POSTURE


@pytest.fixture
def world(brick):
    """An arm at rest, and nothing in its way."""
    pose = np.eye(4)
    pose[:3, 3] = (0.5, 0.4, 0.04)
    return MujocoEngine().build(Placement(brick, pose, READY, Physics()))


@pytest.fixture
def scene(world):
    """A copy of the world's model and state with a step of 1 ms."""
    model, data = world._model, world._data
    model.opt.timestep = 1e-3
    return model, data


def force_after_step(scene, drives):
    """(7,) force of the drives at the end of a step that is taken with them."""
    model, data = scene
    drives.prepare(model, data)
    stretch, damping = data.ctrl[:7] - data.qpos[:7], -model.actuator_biasprm[:7, 2]
    mujoco.mj_step(model, data)
    return ARM_STIFFNESS * stretch - damping * data.qvel[:7]


def test_a_drive_is_a_spring_and_a_damper_about_a_target_that_moves(scene):
    model, data = scene
    drives, rate = ArmDrives(READY), np.full(7, 0.02)
    drives.q, drives.rate = READY + 1e-4, rate
    drives.prepare(model, data)
    force = ARM_STIFFNESS * (data.ctrl[:7] - READY)
    assert force == pytest.approx(ARM_STIFFNESS * 1e-4 + ARM_DAMPING * rate)
    assert model.actuator_biasprm[:7, 2] == pytest.approx(-ARM_DAMPING)


@pytest.mark.parametrize("seed", range(4))
def test_after_each_step_of_a_fast_reversal_each_force_is_within_its_limit(scene, seed):
    drives, to = ArmDrives(READY), np.random.default_rng(seed).uniform(-0.2, 0.2, (6, 7))
    at_limit = np.zeros(7)
    for target in to:
        drives.q = READY + target
        for _ in range(40):
            share = np.abs(force_after_step(scene, drives)) / kin.JOINT_EFFORT
            assert (share < 1.1).all()  # bias forces and the mass matrix are those of the step before
            at_limit = np.maximum(at_limit, share)
    assert (at_limit > 0.98).sum() >= 5


def test_a_joint_at_its_stop_is_pushed_with_its_effort_and_no_more(scene):
    model, data = scene
    data.qpos[3] = kin.JOINT_UPPER[3]
    mujoco.mj_forward(model, data)
    drives = ArmDrives(data.qpos[:7])
    drives.q = data.qpos[:7] + np.where(np.arange(7) == 3, 0.3, 0.0)
    forces = [force_after_step(scene, drives)[3] for _ in range(200)]
    assert forces[-50:] == pytest.approx([kin.JOINT_EFFORT[3]] * 50, rel=0.01)
    assert data.qpos[3] < kin.JOINT_UPPER[3] + 0.005


def test_no_drive_asks_for_more_speed_than_its_joint_may_have(scene):
    model, data = scene
    drives = ArmDrives(READY)
    drives.q, data.qvel[:7] = READY - 1.0, -kin.JOINT_VELOCITY
    drives.prepare(model, data)
    force = ARM_STIFFNESS * (data.ctrl[:7] - READY) - ARM_DAMPING * data.qvel[:7]
    assert force == pytest.approx(np.zeros(7), abs=1e-9)


def test_an_arm_that_is_led_on_does_not_tremble(world):
    rates = []
    for i in range(1, 21):
        world.drive(READY + 0.02 * i)
        rates.append(world.joint_velocities[:7])
    assert np.ptp(rates[5:], axis=0).max() < 0.01
    assert np.mean(rates[5:]) == pytest.approx(0.02 / 0.15, abs=0.03)
