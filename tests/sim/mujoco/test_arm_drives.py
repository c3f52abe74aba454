"""The arm's drives: limits of their force and speed, and an arm that does not tremble."""

import numpy as np
import pytest

from torchgrasp.sim import MujocoEngine, Physics, Placement
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.mujoco.arm_drives import ArmDrives
from torchgrasp.sim.panda_tables import ARM_DAMPING, ARM_STIFFNESS

READY = kin.READY_POSTURE


def find_force(control, q, v):
    return ARM_STIFFNESS * (control - q) - ARM_DAMPING * v


def test_a_drive_is_a_spring_and_a_damper_about_a_target_that_moves():
    drives, rate = ArmDrives(READY), np.full(7, 0.2)
    drives.q, drives.rate = READY + 1e-3, rate
    force = find_force(drives.control(READY, np.zeros(7)), READY, np.zeros(7))
    assert force == pytest.approx(ARM_STIFFNESS * 1e-3 + ARM_DAMPING * rate)


def test_a_blocked_arm_is_pushed_with_its_effort_and_no_more():
    drives = ArmDrives(READY)
    drives.q = READY + 0.5
    drives.control(READY, np.zeros(7))
    for _ in range(3):
        force = find_force(drives.control(READY, np.zeros(7)), READY, np.zeros(7))
        assert force == pytest.approx(kin.JOINT_EFFORT)


def test_no_drive_asks_for_more_speed_than_its_joint_may_have():
    drives = ArmDrives(READY)
    drives.q, v = READY - 1.0, -kin.JOINT_VELOCITY
    assert find_force(drives.control(READY, v), READY, v) == pytest.approx(np.zeros(7), abs=1e-9)


def test_an_arm_that_is_led_on_does_not_tremble(brick):
    pose = np.eye(4)
    pose[:3, 3] = (0.5, 0.4, 0.04)
    world = MujocoEngine().build(Placement(brick, pose, READY, Physics()))
    rates = []
    for i in range(1, 21):
        world.drive(READY + 0.02 * i)
        rates.append(world.joint_velocities[:7])
    assert np.ptp(rates[5:], axis=0).max() < 0.01
    assert np.mean(rates[5:]) == pytest.approx(0.02 / 0.15, abs=0.03)
