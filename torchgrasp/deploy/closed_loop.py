"""One grasp by an arm: pictures in, hand poses out, then close, lift, and tell what is held."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchgrasp.deploy.arm import Arm
from torchgrasp.deploy.command import GraspCommand
from torchgrasp.deploy.depth_camera import DepthCamera
from torchgrasp.deploy.limits import ArmLimits
from torchgrasp.errors import ConfigError, StopError, check_range, check_whole
from torchgrasp.sim.kinematics import forward_kinematics

_AHEAD = 0.02  # seconds that two readings of one clock may be apart
_NAP = 0.0005  # seconds; shorter than a loop can be late without harm


@dataclass(frozen=True)
class GraspOutcome:
    """How a grasp ended.

    Attributes:
        held: whether something is between the fingers after the lift, told from their distance.
        width: metres between the fingers then; NaN where the arm did not come so far.
        steps: control periods in which the agent was asked.
        cause: why the arm was stopped, in a word as in `StopError`; None where it was not.
        reason: the same in a sentence.
        caught: whether something was between the fingers once they had closed, before the lift. What was
            caught and is not held has slipped.
    """

    held: bool
    width: float
    steps: int
    cause: str | None = None
    reason: str = ""
    caught: bool = False


class ClosedLoop:
    """Drives an arm by an agent's commands, 6.7 times a second.

    In each control period the camera is read, the agent asked, and its pose held against the limits, in this
    order, before the arm sets out for it. The arm is stopped, and `run` says why, where

    - the picture is old, or cannot be used several times in a row (``picture``),
    - the command comes too late after its period began (``late``),
    - the arm stands, or would stand, outside the limits (``limits``),
    - the robot has stopped by itself (``reflex``) or does not answer (``robot``),
    - ctrl-C is pressed (``interrupted``).

    A motion ends at rest, so that an arm whose loop hangs stands still after the step that is under way:
    within two periods.

    Args:
        arm: FrankaArm, DryArm or another `Arm`.
        agent: GraspAgent of one arm, with the camera's intrinsics and pose.
        camera: a `DepthCamera`.
        limits: of the arm; those that the arm itself was given, if None.
        watchdog: seconds that a command may be late.
        max_age: seconds that a picture may be old.
        patience: pictures in a row that the agent cannot use.
        force: of the fingers, N.
        lift_height: metres.
        min_width: metres between the fingers above which something is held.
        clock: seconds, the same as that of the pictures.
        tell: is told each command with the number of its step, for a log.
    """

    def __init__(
        self,
        arm: Arm,
        agent: Any,
        camera: DepthCamera,
        *,
        limits: ArmLimits | None = None,
        watchdog: float = 0.1,
        max_age: float = 0.2,
        patience: int = 7,
        force: float = 30.0,
        lift_height: float = 0.15,
        min_width: float = 0.001,
        clock: Callable[[], float] = time.monotonic,
        tell: Callable[[int, GraspCommand], object] | None = None,
    ) -> None:
        for name, value in (("watchdog", watchdog), ("max_age", max_age)):
            check_range(name, value, 0.0, 60.0, open_low=True)
        check_range("force", force, 0.0, 140.0, open_low=True)  # a Franka hand's most
        check_range("lift_height", lift_height, 0.0, 1.0)
        check_range("min_width", min_width, 0.0, 0.08)
        check_whole("patience", patience, 1)
        self.arm, self.agent, self.camera = arm, agent, camera
        self.limits = _choose_limits(arm, limits)
        _check_agent(agent, self.limits)
        self._period = agent.period
        self._watchdog, self._max_age, self._patience = watchdog, max_age, patience
        self._force, self._lift_height, self._min_width = force, lift_height, min_width
        self._clock, self._tell = clock, tell
        self._steps, self._caught = 0, False

    def run(self) -> GraspOutcome:
        """Grasp once: reset the agent, approach, close, lift, look at the fingers' distance."""
        self._steps, self._caught = 0, False
        try:
            return self._grasp()
        except StopError as error:
            self.arm.stop()
            return self._stopped(error.cause, str(error))
        except KeyboardInterrupt:
            self.arm.stop()
            return self._stopped("interrupted", "ctrl-C")
        except BaseException:
            self.arm.stop()
            raise

    def _stopped(self, cause: str, reason: str) -> GraspOutcome:
        return GraspOutcome(False, float("nan"), self._steps, cause, reason, self._caught)

    def _grasp(self) -> GraspOutcome:
        self.agent.reset()
        _, hand = self._find_hand()
        self.limits.check_pose(hand)
        self.arm.open()
        self._approach()
        self.arm.grasp(self._force)
        self._caught = self.arm.width > self._min_width
        joints, hand = self._find_hand()
        hand[2, 3] = min(hand[2, 3] + self._lift_height, self.limits.workspace[1][2])
        hand = self.limits.reach(joints, hand)
        self.limits.check_pose(hand)
        self.arm.go(hand)
        width = self.arm.width
        return GraspOutcome(width > self._min_width, width, self._steps, caught=self._caught)

    def _find_hand(self) -> tuple[np.ndarray, np.ndarray]:
        """Joints (7,), which are within their limits, and the hand's pose (4, 4)."""
        joints = self.arm.joints
        self.limits.check_joints(joints)
        return joints, forward_kinematics(joints[None])[0]

    def _approach(self) -> None:
        """Follow the agent until it says that the fingers close."""
        unused, due = 0, self._clock()
        while True:
            self._wait_until(due)
            joints, hand, command = self._look()
            if command.problem is not None:
                unused += 1
                if unused >= self._patience:
                    raise StopError("picture", f"{command.problem}, {unused} times in a row")
            else:
                unused = 0
            target = self.limits.shorten(hand, command.T_base_ee, self._period)
            target = self.limits.reach(joints, target)
            self.limits.check_pose(target)
            # The first pass of a network takes longer than those after it; the arm still stands then.
            if self._steps and (late := self._clock() - due) > self._watchdog:
                raise StopError("late", f"the command came {late:.3f} s late, more than {self._watchdog:g}")
            # Where the agent holds, the step that is under way ends, and no other begins.
            if command.problem is None or command.action.any():
                self.arm.follow(target, self._period)
            self._steps += 1
            if self._tell is not None:
                self._tell(self._steps, command)
            if command.close:
                return
            due = max(due + self._period, self._clock())

    def _look(self) -> tuple[np.ndarray, np.ndarray, GraspCommand]:
        """Joints (7,) and hand (4, 4) as they are now, and what the agent makes of a picture."""
        picture = self.camera.read()
        joints, hand = self._find_hand()
        age = self._clock() - picture.time
        if not age >= -_AHEAD:
            raise StopError(
                "picture",
                f"the picture's time is {picture.time}, ahead of the loop's clock by {-age:.2f} s: give the "
                "time by that clock, time.monotonic where none is given",
            )
        if not age <= self._max_age:
            raise StopError("picture", f"the picture is {age:.2f} s old, more than {self._max_age:g}")
        then = joints if picture.joints is None else picture.joints
        command = self.agent.act(picture.depth, picture.mask, joints=then, age=max(age, 0.0))
        return joints, hand, command

    def _wait_until(self, due: float) -> None:
        while self._clock() < due:
            time.sleep(_NAP)


def _choose_limits(arm: Arm, limits: ArmLimits | None) -> ArmLimits:
    """The limits of arm and loop, which are the same."""
    of_arm = getattr(arm, "limits", None)
    if limits is not None and of_arm is not None and limits != of_arm:
        raise ConfigError("limits differ from those that the arm was given: give them to the arm alone.")
    return limits or of_arm or ArmLimits()


def _check_agent(agent: Any, limits: ArmLimits) -> None:
    """Refuse an agent that a loop of one arm and one camera cannot ask."""
    if agent.num_arms is not None:
        raise ConfigError(f"agent is of num_arms={agent.num_arms}: give one of a single arm, num_arms=None.")
    if agent.intrinsics is None:
        raise ConfigError("agent takes no pictures: give GraspAgent the camera's intrinsics.")
    if agent.on_problem == "raise":
        raise ConfigError("agent raises at a bad picture, which the loop counts: give on_problem='hold'.")
    if agent.table_height != limits.table_height:
        raise ConfigError(
            f"table_height is {agent.table_height} for the agent and {limits.table_height} in the limits: "
            "give both the same."
        )
