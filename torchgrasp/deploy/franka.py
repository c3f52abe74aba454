"""A Franka arm, FR3 or Panda, over libfranka's protocol: follows hand poses, grasps, stops with a reason."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from torchgrasp.deploy.limits import ArmLimits
from torchgrasp.errors import ConfigError, MissingPackageError, StopError, check_range
from torchgrasp.sim.kinematics import HAND_YAW, forward_kinematics

_POLL = 0.002  # seconds between two questions whether a motion is over
_OPEN, _OPENING_SPEED, _CLOSING_SPEED = 0.08, 0.1, 0.1  # m, m/s
# A grasp may end at any width: what is held is told from the width, not from the gripper's answer.
_ANY_WIDTH = {"epsilon_inner": 0.1, "epsilon_outer": 0.1}
# Of a control period: what is left of it goes into speeding up and slowing down.
_EVEN = 0.8
_SLOWEST = 0.02  # of the limits' speed
_SAME_FRAME = 0.01  # metres, and entries of a rotation
_PATIENCE = 30.0  # seconds that a motion may last


class FrankaArm:
    """An arm of Franka Robotics with its hand, by franky. An `Arm`, to be used with `with`.

    Poses are those of the hand's link, frame `ee`. They are turned into the end effector that the robot is
    configured with, whatever that is, by what the robot itself says of it.

    Args:
        host: address of the robot.
        limits: speeds and collision thresholds are set from them; `ClosedLoop` checks the rest.
        realtime: whether the operating system has to give the motions real-time priority, as libfranka asks
            for on a real arm; a rehearsal on the loopback does without.

    Raises:
        MissingPackageError: without franky.
        ConfigError: where the robot's hand is not where a Franka's joints put it.
        StopError: where the robot cannot be reached.
    """

    def __init__(self, host: str, *, limits: ArmLimits | None = None, realtime: bool = True) -> None:
        self.limits = limits or ArmLimits()
        self._franky = franky = _load_franky()
        config = franky.RealtimeConfig.Enforce if realtime else franky.RealtimeConfig.Ignore
        share = self.limits.acceleration
        with self._telling():
            self._robot = franky.Robot(
                host,
                relative_dynamics_factor=franky.RelativeDynamicsFactor(1.0, share, share),
                default_torque_threshold=self.limits.joint_torque,
                default_force_threshold=self.limits.force,
                realtime_config=config,
            )
            self._robot.translation_velocity_limit.set(self.limits.speed)
            self._robot.rotation_velocity_limit.set(self.limits.turn_rate)
            self._gripper = franky.Gripper(host)
        try:
            self._check_frames()
        except BaseException:
            del self._robot, self._gripper
            raise

    def __enter__(self) -> FrankaArm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        del self._robot, self._gripper

    @property
    def joints(self) -> np.ndarray:
        """See `Arm.joints`."""
        with self._telling():
            return np.asarray(self._robot.state.q, dtype=np.float64).reshape(7)

    @property
    def T_base_ee(self) -> np.ndarray:
        """(4, 4) pose of the hand, as the robot tells it."""
        with self._telling():
            return _hand_pose(self._robot.state)

    @property
    def width(self) -> float:
        """See `Arm.width`."""
        with self._telling():
            return float(self._gripper.width)

    def follow(self, T_base_ee: np.ndarray, seconds: float) -> None:
        """See `Arm.follow`: at an even pace, so that the arm does not halt at each pose."""
        limits, here = self.limits, self.T_base_ee
        way = float(np.linalg.norm(T_base_ee[:3, 3] - here[:3, 3]))
        turn = float(Rotation.from_matrix(here[:3, :3].T @ T_base_ee[:3, :3]).magnitude())
        share = max(way / limits.speed, turn / limits.turn_rate) / (_EVEN * seconds)
        self._set_out(T_base_ee, min(max(share, _SLOWEST), 1.0))

    def go(self, T_base_ee: np.ndarray) -> None:
        """See `Arm.go`, at the limits' `lift_speed`."""
        self._set_out(T_base_ee, min(1.0, self.limits.lift_speed / self.limits.speed))
        self._wait(self._in_motion)

    def go_to_joints(self, q: np.ndarray, *, speed: float = 0.1) -> None:
        """Move to (7,) angles, rad, at a share of the joints' speed; returns when the arm is there.

        The end is held against the limits; the way there is not.

        Raises:
            ConfigError: where `q` is no posture, or `speed` no share.
            StopError: where the arm would stand outside the limits, or stops on its way.
        """
        check_range("speed", speed, 0.0, 1.0, open_low=True)
        target = np.asarray(q, dtype=np.float64)
        if target.shape != (7,) or not np.isfinite(target).all():
            raise ConfigError(f"q={q} is no posture: give the seven angles in radians.")
        self.limits.check_joints(target)
        self.limits.check_pose(forward_kinematics(target[None])[0])
        with self._telling():
            motion = self._franky.JointMotion(target.tolist(), relative_dynamics_factor=speed)
            self._robot.move(motion, asynchronous=True)
        self._wait(self._in_motion)

    def grasp(self, force: float) -> None:
        """See `Arm.grasp`."""
        self._wait(self._in_motion)
        self._wait_for(lambda: self._gripper.grasp_async(0.0, _CLOSING_SPEED, force, **_ANY_WIDTH))

    def open(self) -> None:
        """See `Arm.open`."""
        self._wait_for(lambda: self._gripper.move_async(_OPEN, _OPENING_SPEED))

    def stop(self) -> None:
        """See `Arm.stop`: the arm brakes on its way; a motion that cannot brake is cut off.

        Fingers that are on their way end it: franky gives the hand no command before the last one is over.
        """
        franky, robot = self._franky, self._robot
        with contextlib.suppress(Exception):
            if not robot.is_in_control:
                return
            joints = robot.current_control_signal_type == franky.ControlSignalType.JointPositions
            robot.move(
                franky.JointStopMotion() if joints else franky.CartesianStopMotion(), asynchronous=True
            )
            if robot.join_motion(timeout=1.0):
                return
        with contextlib.suppress(Exception):
            robot.stop()

    def _check_frames(self) -> None:
        """Refuse a robot whose hand is not where its joints put a Franka's."""
        with self._telling():
            state = self._robot.state
        there = forward_kinematics(np.asarray(state.q, dtype=np.float64).reshape(1, 7))[0]
        apart = np.abs(_hand_pose(state) - there).max()
        if apart > _SAME_FRAME:
            raise ConfigError(
                f"The robot tells another pose of its hand than a Franka's joints give ({apart:.3f} apart): "
                "look at F_T_EE and O_T_EE of its state."
            )

    def _set_out(self, T_base_ee: np.ndarray, share: float) -> None:
        franky = self._franky
        with self._telling():
            self._robot.join_motion(timeout=0.0)  # what has ended the motion before is raised here
            target = T_base_ee @ _hand_to_effector(self._robot.state)
            factor = franky.RelativeDynamicsFactor(share, 1.0, 1.0)
            motion = franky.CartesianMotion(franky.Affine(target), relative_dynamics_factor=factor)
            self._robot.move(motion, asynchronous=True)

    def _in_motion(self) -> bool:
        return not self._robot.join_motion(timeout=0.0)

    def _wait_for(self, start: Callable[[], Any]) -> None:
        """Start a command of the gripper and wait for its end."""
        with self._telling():
            future = start()
        self._wait(lambda: not future.wait(0.0))
        with self._telling():
            future.get()

    def _wait(self, busy: Callable[[], bool]) -> None:
        """Wait in Python, where ctrl-C is heard, not in the library."""
        until = time.monotonic() + _PATIENCE
        with self._telling():
            while busy():
                if time.monotonic() > until:
                    self.stop()
                    raise StopError("robot", f"a motion is not over after {_PATIENCE:g} s")
                time.sleep(_POLL)

    @contextlib.contextmanager
    def _telling(self) -> Iterator[None]:
        """Turn franky's exceptions into StopError."""
        franky = self._franky
        try:
            yield
        except franky.ControlException as error:
            raise StopError("reflex", f"the robot stopped by itself ({_first_line(error)})") from error
        except (franky.Exception, franky.NetworkException, franky.CommandException, RuntimeError) as error:
            raise StopError("robot", f"the robot does not do it ({_first_line(error)})") from error


def _hand_pose(state: Any) -> np.ndarray:
    """(4, 4) pose of the hand, whatever end effector is configured."""
    return state.O_T_EE.matrix @ np.linalg.inv(_hand_to_effector(state))


def _hand_to_effector(state: Any) -> np.ndarray:
    """(4, 4) pose of the configured end effector in the hand's frame."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(HAND_YAW), -np.sin(HAND_YAW)], [np.sin(HAND_YAW), np.cos(HAND_YAW)]]
    return np.linalg.inv(turn) @ state.F_T_EE.matrix


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def _load_franky() -> Any:
    try:
        import franky
    except ImportError as error:
        raise MissingPackageError(
            f'A Franka arm needs the extra franka ({error}): pip install "torchgrasp[franka]".'
        ) from error
    return franky
