"""The closed loop over libfranka's protocol: a grasp, and every stop provoked for real."""

import re
import signal
import time

import numpy as np
import pytest

from tests.deploy.stage import CAMERA, agent, connected, drawn, make_loop, rehearse, wait_for
from torchgrasp.deploy import ArmLimits, ClosedLoop, DryArm, GraspAgent, Picture
from torchgrasp.deploy.rehearsal import RehearsalCamera
from torchgrasp.errors import ConfigError
from torchgrasp.sim.kinematics import forward_kinematics


class Tampered:
    """A camera whose pictures are changed from the sixth on."""

    def __init__(self, camera, change):
        self.camera, self.change, self.last, self.reads = camera, change, None, 0

    def read(self):
        self.reads += 1
        if self.reads < 6:
            self.last = self.camera.read()
            return self.last
        return self.change(self)


def freeze(eye):
    """The camera hangs: its last picture again and again."""
    return eye.last


def black_out(eye):
    picture = eye.camera.read()
    return Picture(np.zeros_like(picture.depth), picture.mask, picture.time)


def is_at_rest(rehearsal):
    before, began = rehearsal.now, rehearsal.clock()
    wait_for(lambda: rehearsal.clock() > began + 0.3)
    return np.abs(rehearsal.now.joints[:7] - before.joints[:7]).max() < 1e-3


def test_the_pretrained_policy_grasps_over_libfranka_s_protocol():
    told = []
    with connected() as (rehearsal, arm):
        loop = make_loop(rehearsal, arm, tell=lambda step, command: told.append((step, bool(command.close))))
        began = rehearsal.clock()
        outcome = loop.run()
        spent = rehearsal.clock() - began
        assert outcome.cause is None and outcome.steps == 30
        assert outcome.caught and outcome.held and outcome.width > 0.005
        assert rehearsal.risen > 0.08
        # 30 periods of 0.15 s, closing, lifting by 15 cm at 15 cm/s.
        assert 5.5 < spent < 9.0
    assert told == [(step, step == 30) for step in range(1, 31)]


def test_a_dry_run_prints_commands_and_needs_no_robot():
    _, scene = drawn()
    lines, periods = [], set()

    class Noting(DryArm):
        def follow(self, T_base_ee, seconds):
            periods.add(seconds)
            super().follow(T_base_ee, seconds)

    arm = Noting(scene.q, write=lines.append)
    with rehearse() as rehearsal:
        outcome = make_loop(rehearsal, arm, period=0.01).run()
        assert np.abs(rehearsal.now.joints[:7] - scene.q).max() < 1e-3
    assert periods == {0.01}  # the agent's
    assert outcome.steps == 30 and not (outcome.caught or outcome.held) and np.isnan(outcome.width)
    assert lines[0] == "open the fingers" and lines[1].startswith("hand to x ")
    assert lines[31] == "close the fingers with 30 N" and lines[32].startswith("slowly to ")
    assert len(lines) == 33


@pytest.mark.parametrize(
    ("change", "options", "reason"),
    [
        (freeze, {"max_age": 0.3}, "the picture is 0.[34]"),
        (black_out, {"patience": 3}, "depth has no return at any pixel, 3 times in a row"),
    ],
)
def test_a_picture_that_is_stale_or_empty_stops_the_arm(change, options, reason):
    with connected() as (rehearsal, arm):
        camera = Tampered(RehearsalCamera(rehearsal, CAMERA), change)
        outcome = make_loop(rehearsal, arm, camera=camera, **options).run()
        assert outcome.cause == "picture" and outcome.steps >= 5
        assert re.match(reason, outcome.reason)
        assert is_at_rest(rehearsal)


def test_a_loop_that_is_late_stops_the_arm():
    def dawdle(eye):
        until = rehearsal.clock() + 0.4
        while rehearsal.clock() < until:
            time.sleep(0.005)
        return eye.camera.read()

    with connected() as (rehearsal, arm):
        camera = Tampered(RehearsalCamera(rehearsal, CAMERA), dawdle)
        outcome = make_loop(rehearsal, arm, camera=camera, watchdog=0.35).run()
        assert outcome.cause == "late" and outcome.steps == 5
        assert outcome.reason.endswith("s late, more than 0.35")
        assert is_at_rest(rehearsal)


def test_a_reflex_of_the_robot_ends_the_grasp():
    with connected() as (rehearsal, arm):

        def bump(step, _):
            if step == 5:
                rehearsal.abort_motion()

        outcome = make_loop(rehearsal, arm, tell=bump).run()
        assert outcome.cause == "reflex" and "aborted by reflex" in outcome.reason
        assert is_at_rest(rehearsal)


def test_a_target_outside_the_workspace_stops_the_arm_before_it_goes_there():
    _, scene = drawn()
    start = forward_kinematics(scene.q[None])[0, :3, 3]
    # The hand may sink by 5 cm, which is less than every grasp needs.
    low = ((-1.0, -1.0, float(start[2]) - 0.05), (1.0, 1.0, 1.5))
    limits = ArmLimits(workspace=low)
    with connected(limits) as (rehearsal, arm):
        outcome = make_loop(rehearsal, arm).run()
        assert outcome.cause == "limits" and outcome.steps >= 1
        assert "outside of the workspace" in outcome.reason
        assert arm.T_base_ee[2, 3] > low[0][2] - 0.002


def test_an_arm_that_stands_outside_its_limits_does_not_set_out():
    limits = ArmLimits(workspace=((0.0, 0.0, 0.0), (0.1, 0.1, 0.1)))
    with connected(limits) as (rehearsal, arm):
        outcome = make_loop(rehearsal, arm).run()
        assert (outcome.cause, outcome.steps) == ("limits", 0)
        assert np.abs(rehearsal.now.joints[:7] - drawn()[1].q).max() < 1e-3


def test_ctrl_c_stops_the_arm():
    with connected() as (rehearsal, arm):
        loop = make_loop(
            rehearsal, arm, tell=lambda step, _: signal.raise_signal(signal.SIGINT) if step == 4 else None
        )
        # What is started in the background ignores ctrl-C.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            outcome = loop.run()
        finally:
            signal.signal(signal.SIGINT, before)
        assert (outcome.cause, outcome.steps) == ("interrupted", 4)
        assert is_at_rest(rehearsal)


def test_an_error_of_one_s_own_stops_the_arm_and_goes_on():
    with connected() as (rehearsal, arm):
        loop = make_loop(rehearsal, arm, tell=lambda step, _: {}[step])
        with pytest.raises(KeyError):
            loop.run()
        assert is_at_rest(rehearsal)


@pytest.mark.parametrize("option", [{"force": 200.0}, {"patience": 0}, {"watchdog": -1.0}])
def test_impossible_options_are_refused(option):
    (name,) = option
    with pytest.raises(ConfigError, match=name):
        ClosedLoop(DryArm(np.zeros(7)), agent(), None, **option)


def test_a_picture_of_another_clock_stops_the_arm():
    """Its age would be below zero for ever, however long the camera hangs."""

    def stamp(eye):
        picture = eye.camera.read()
        return Picture(picture.depth, picture.mask, picture.time + 1e6)

    with connected() as (rehearsal, arm):
        loop = make_loop(rehearsal, arm, camera=Tampered(RehearsalCamera(rehearsal, CAMERA), stamp))
        outcome = loop.run()
        assert (outcome.cause, outcome.steps) == ("picture", 5)
        assert "ahead of the loop's clock" in outcome.reason
        assert is_at_rest(rehearsal)


def test_arm_agent_and_loop_that_do_not_fit_are_refused():
    arm = DryArm(drawn()[1].q)
    several, blind = GraspAgent("pretrained", num_arms=2), GraspAgent("pretrained")
    for wrong, told in ((several, "num_arms"), (blind, "intrinsics")):
        with pytest.raises(ConfigError, match=told):
            ClosedLoop(arm, wrong, None)
    with pytest.raises(ConfigError, match="table_height"):
        ClosedLoop(arm, agent(), None, limits=ArmLimits(table_height=0.1))
    arm.limits = ArmLimits(speed=0.1)
    with pytest.raises(ConfigError, match="limits differ"):
        ClosedLoop(arm, agent(), None, limits=ArmLimits(speed=0.3))
    assert ClosedLoop(arm, agent(), None).limits.speed == 0.1
