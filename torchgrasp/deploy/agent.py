"""GraspAgent: from a camera's pictures and an arm's joints to the next pose of its hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.config.trained_policy import TrainedPolicy, load_policy
from torchgrasp.config.trained_view import make_view, training_focal
from torchgrasp.deploy.command import GraspCommand
from torchgrasp.deploy.sight import FRAMES, Frame, Sight, read_cloud, read_picture
from torchgrasp.errors import ConfigError, PictureError, check_range, check_whole
from torchgrasp.geometry import action_to_pose, goal_to_pose, pose_to_action
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim.control import TABLE_GUARD
from torchgrasp.sim.kinematics import forward_kinematics

OnProblem = Literal["hold", "look", "raise"]
_ON_PROBLEM = ("hold", "look", "raise")
_FINGERS_OPEN = 0.04  # metres, of each finger


class GraspAgent:
    """A trained policy for one's own camera and arm.

    Each control period of 0.15 s it is shown what the camera sees and how the arm stands, and says where the
    hand is to go. It runs the transforms that the policy was trained with, but for those that make a
    simulated sensor err, and remembers what an episode has shown. It imports no simulator.

    The hand's frame `ee` is that of a Franka hand (`panda_hand`): z to the fingers' tips, y along their
    opening. Another gripper stands at the same place between its fingers, 10.3 cm behind the tips' middle.

    Args:
        policy: ``pretrained``, a run directory, a weights file, or what `torchgrasp.load_policy` gave.
        intrinsics: of the camera; None where clouds are given instead of pictures.
        T_ee_camera: (4, 4) pose of a camera on the hand (OpenCV axes), from a hand-eye calibration.
        T_base_camera: (4, 4) pose of a camera that stands still, in place of it.
        table_height: metres of the table's top above the origin of the base frame.
        num_arms: None for one arm; N for several, whose arguments and commands have a first dimension N.
        on_problem: what happens where a picture cannot be used: the hand stays (``hold``), goes back to where
            it last saw the target (``look``), or PictureError is raised (``raise``). Such a step does not
            count.
        max_age: seconds; an older picture is not used.
        holes_are_empty: whether a pixel without a return means that nothing stands within range, as in
            simulation. A real sensor has holes.
        thin: every so many rows and columns of a picture are used; None for pixels twice as fine as those of
            training.
        period: seconds of a control period, for `GraspCommand.age`.
        trust: see `torchgrasp.load_policy`.
        device: of the network.

    Raises:
        ConfigError: where an argument is impossible, or the policy reads what no camera of one arm shows.

    Example:
        >>> import numpy as np
        >>> from torchgrasp import GraspAgent
        >>> agent = GraspAgent("pretrained", table_height=0.0)
        >>> ready = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
        >>> ball = np.random.default_rng(0).normal(size=(500, 3))
        >>> ball = 0.03 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0.5, 0.0, 0.03]
        >>> command = agent.act(points=ball, frame="base", joints=ready)
        >>> command.T_base_ee.shape, bool(command.close), command.problem
        ((4, 4), False, None)
    """

    def __init__(
        self,
        policy: TrainedPolicy | str | Path = "pretrained",
        *,
        intrinsics: CameraIntrinsics | None = None,
        T_ee_camera: Any = None,
        T_base_camera: Any = None,
        table_height: float = 0.0,
        num_arms: int | None = None,
        on_problem: OnProblem = "hold",
        max_age: float = 0.5,
        holes_are_empty: bool = False,
        thin: int | None = None,
        period: float = 0.15,
        trust: Iterable[str] = (),
        device: torch.device | str = "cpu",
    ) -> None:
        if num_arms is not None:
            check_whole("num_arms", num_arms, 1)
        if on_problem not in _ON_PROBLEM:
            raise ConfigError(f"on_problem={on_problem!r} is unknown: give {', '.join(_ON_PROBLEM)}.")
        check_range("max_age", max_age, 0.0, float("inf"))
        check_range("period", period, 0.0, float("inf"), open_low=True)
        check_range("table_height", table_height, -10.0, 10.0)
        if T_ee_camera is not None and T_base_camera is not None:
            raise ConfigError(
                "T_ee_camera and T_base_camera are both given: a camera is on the hand, or stands still."
            )
        trained = policy if isinstance(policy, TrainedPolicy) else load_policy(policy, trust=trust)
        self.policy = trained.to(device)
        self.horizon = trained.horizon
        self.num_arms, self.on_problem, self.max_age = num_arms, on_problem, max_age
        self.table_height, self.period, self.holes_are_empty = float(table_height), period, holes_are_empty
        self._hand_camera = None if T_ee_camera is None else _read_pose("T_ee_camera", T_ee_camera)
        self._static_camera = None if T_base_camera is None else _read_pose("T_base_camera", T_base_camera)
        self.intrinsics, self._thin = intrinsics, 1
        if intrinsics is not None:
            focal = float(intrinsics.focal.min())
            finest = max(1, int(focal / (2 * training_focal(trained))))
            self._thin = finest if thin is None else thin
            check_whole("thin", self._thin, 1, min(intrinsics.width, intrinsics.height))
        seen = None if intrinsics is None else intrinsics.thin_out(self._thin)
        self._arms = [
            _Arm(row, make_view(trained, intrinsics=seen, table_height=self.table_height))
            for row in range(num_arms or 1)
        ]
        self._device = torch.device(device)

    def reset(self, arms: Sequence[int] | None = None) -> None:
        """Begin an episode of all arms, or of those named: nothing has been seen, all T steps are left."""
        for arm in self._arms if arms is None else [self._arms[row] for row in arms]:
            arm.reset()

    @torch.no_grad()
    def act(
        self,
        depth: Any = None,
        mask: Any = None,
        *,
        points: Any = None,
        frame: Frame = "camera",
        joints: Any = None,
        T_base_ee: Any = None,
        T_base_camera: Any = None,
        age: Any = 0.0,
    ) -> GraspCommand:
        """The next step of each arm.

        Args:
            depth: (*, H, W) metres as floats, or millimetres as 16-bit whole numbers; 0 and NaN are holes.
            mask: (*, H, W), not zero at the target's pixels, of any segmenter.
            points: (*, n, 3) the target's points in place of pictures, metres; for N arms a sequence of N
                clouds.
            frame: of the points: ``ee``, ``camera`` or ``base``.
            joints: (*, 7) angles of a Panda's arm in radians, or (*, 9) with both fingers in metres. The
                hand's pose follows from them where it is not given.
            T_base_ee: (*, 4, 4) pose of the hand when the picture was taken.
            T_base_camera: (*, 4, 4) pose of the camera then, in place of what the agent was told.
            age: seconds since the picture was taken.

        Raises:
            ConfigError: where the call is wrong: arguments of a wrong shape, or too few of them.
            PictureError: where a picture cannot be used and `on_problem` is ``raise``.
        """
        over = [arm.number for arm in self._arms if arm.steps >= self.horizon]
        if over:
            raise ConfigError(
                f"The episode of {self.horizon} steps is over for arm {over[0]}: close its fingers, lift, "
                "and call reset before the next."
            )
        joints, hands = self._read_arms(joints, T_base_ee)
        cameras = self._find_cameras(T_base_camera, hands)
        ages = np.broadcast_to(np.asarray(age, dtype=np.float64), len(self._arms))
        sights = self._look(depth, mask, points, frame, hands, cameras)
        problems = [self._find_problem(*each) for each in zip(self._arms, sights, ages.tolist(), strict=True)]
        if self.on_problem == "raise" and (first := next(filter(None, problems), None)) is not None:
            raise PictureError(f"{first}: take another picture, or stop.")
        acting = [row for row, problem in enumerate(problems) if problem is None]
        targets, actions = hands.copy(), np.zeros((len(hands), 6), dtype=np.float32)
        goals = np.full((len(hands), 4, 4), np.nan)
        if acting:
            states: Any = torch.cat(
                [
                    self._arms[row].see(sights[row], hands[row], cameras[row], joints[row], self.horizon)
                    for row in acting
                ]
            )
            out = self.policy(states.to(self._device)).cpu()
            actions[acting] = out[keys.ACTION].numpy()
            targets[acting] = self._raise(hands[acting] @ _pose(action_to_pose, out[keys.ACTION]))
            if (goal := out.get(keys.GOAL_PREDICTION, None)) is not None:
                goals[acting] = hands[acting] @ _pose(goal_to_pose, goal)
        for row, arm in enumerate(self._arms):
            arm.note(sights[row], hands[row], ages[row], acted=row in acting, period=self.period)
            if row not in acting and self.on_problem == "look" and arm.T_base_seen is not None:
                targets[row] = self._raise(arm.T_base_seen[None])[0]
                back = np.linalg.solve(hands[row], targets[row])
                actions[row] = pose_to_action(torch.from_numpy(back)).numpy()
        closing = [row in acting and arm.steps == self.horizon for row, arm in enumerate(self._arms)]
        command = {
            "T_base_ee": targets,
            "action": actions,
            "close": np.array(closing),
            "goal": goals,
            "num_points": np.array([arm.num_points for arm in self._arms]),
            "age": np.array([arm.age for arm in self._arms]),
        }
        if self.num_arms is None:
            command = {name: each[0] for name, each in command.items()}
        return GraspCommand(**command, problems=tuple(problems))

    def _read_arms(self, joints: Any, T_base_ee: Any) -> tuple[list[np.ndarray | None], np.ndarray]:
        """Joints (9,) of each arm, if there are any, and the (N, 4, 4) poses of the hands."""
        n = len(self._arms)
        if joints is None and T_base_ee is None:
            raise ConfigError("joints and T_base_ee are both missing: give one, from the same moment.")
        if joints is None:
            return [None] * n, _read_pose("T_base_ee", T_base_ee, self.num_arms).reshape(n, 4, 4)
        q = _read_numbers("joints", joints)
        batch = () if self.num_arms is None else (self.num_arms,)
        shapes = [(*batch, size) for size in (7, 9)]
        if q.shape not in shapes:
            raise ConfigError(f"joints of shape {q.shape}: give {shapes[0]}, or {shapes[1]} with fingers.")
        q = q.reshape(n, -1)
        if T_base_ee is None:
            hands = forward_kinematics(q[:, :7])
        else:
            hands = _read_pose("T_base_ee", T_base_ee, self.num_arms).reshape(n, 4, 4)
        fingers = np.full((n, 2), _FINGERS_OPEN) if q.shape[1] == 7 else q[:, 7:]
        return list(np.concatenate((q[:, :7], fingers), axis=1)), hands

    def _find_cameras(self, T_base_camera: Any, hands: np.ndarray) -> list[np.ndarray | None]:
        """(4, 4) pose of each arm's camera, None where nothing tells it."""
        if T_base_camera is not None:
            return list(_read_pose("T_base_camera", T_base_camera, self.num_arms).reshape(hands.shape))
        if self._static_camera is not None:
            return [self._static_camera] * len(hands)
        return [None] * len(hands) if self._hand_camera is None else list(hands @ self._hand_camera)

    def _look(
        self, depth: Any, mask: Any, points: Any, frame: Frame, hands: np.ndarray, cameras: list
    ) -> list[Sight]:
        """What each arm is shown; clouds in the hand's frame."""
        if self.intrinsics is None:
            if points is None or depth is not None or mask is not None:
                raise ConfigError(
                    "The agent was told no intrinsics, so that it takes points: give points alone, or "
                    "intrinsics to GraspAgent for depth and mask."
                )
            if frame not in FRAMES:
                raise ConfigError(f"frame={frame!r} is unknown: give {', '.join(FRAMES)}.")
            clouds = [read_cloud(each) for each in self._each("points", points)]
            return [_into_hand(*each, frame) for each in zip(clouds, hands, cameras, strict=True)]
        if depth is None or mask is None or points is not None:
            raise ConfigError("depth and mask belong together: give both, and no points beside them.")
        if any(camera is None for camera in cameras):
            raise ConfigError(
                "Nothing tells where the camera is: give T_ee_camera or T_base_camera to GraspAgent, or "
                "T_base_camera to each act."
            )
        pictures = zip(self._each("depth", depth), self._each("mask", mask), strict=True)
        options: Any = {"thin": self._thin, "holes_are_empty": self.holes_are_empty}
        return [read_picture(*each, self.intrinsics, **options) for each in pictures]

    def _each(self, name: str, value: Any) -> list:
        """What belongs to each arm."""
        if self.num_arms is None:
            return [value]
        if not hasattr(value, "__len__") or len(value) != self.num_arms:
            raise ConfigError(
                f"{name} is not of {self.num_arms} arms: give a first dimension of that length."
            )
        return list(value)

    def _find_problem(self, arm: _Arm, sight: Sight, age: float) -> str | None:
        if not age >= 0.0:
            raise ConfigError(f"age={age}: give seconds since the picture was taken, 0 or more.")
        if age > self.max_age:
            return f"the picture is {age:.2f} s old, more than max_age={self.max_age}"
        if sight.problem is None and not sight.shows_target and arm.T_base_seen is None:
            return "no point of the target has been seen yet"
        return sight.problem

    def _raise(self, hands: np.ndarray) -> np.ndarray:
        """Hand poses (N, 4, 4) above the table, as training's controller holds them."""
        hands = hands.copy()
        lowest = lowest_point(hands) - self.table_height
        hands[:, 2, 3] += np.maximum(0.0, TABLE_GUARD - lowest)
        return hands


class _Arm:
    """One arm's episode: its view, the steps taken, and where and when the target was last seen."""

    def __init__(self, number: int, view: Any) -> None:
        self.number, self.view = number, view
        self.episode = self.steps = 0
        self.reset()

    def reset(self) -> None:
        """Forget the episode; one that has not begun stays as it is."""
        self.episode += self.steps > 0
        self.steps = self.num_points = 0
        self.age = float("inf")
        self.T_base_seen: np.ndarray | None = None

    def see(
        self,
        sight: Sight,
        T_base_ee: np.ndarray,
        T_base_camera: np.ndarray | None,
        joints: np.ndarray | None,
        horizon: int,
    ) -> TensorDictBase:
        """The state [1] that the policy reads."""
        left = torch.tensor([[1.0 - self.steps / horizon]], dtype=torch.float32)
        where = {keys.WORLD: torch.tensor([[self.number]]), keys.EPISODE: torch.tensor([[self.episode]])}
        state = TensorDict({**where, keys.TIME_LEFT: left}, [1])
        state[keys.T_BASE_EE] = _row(T_base_ee)
        if joints is not None:
            state[keys.JOINTS] = _row(joints)
        if T_base_camera is not None:
            state[keys.T_BASE_CAMERA] = _row(T_base_camera)
        if sight.points is not None:
            state[keys.POINTS] = _row(sight.points)
            state[keys.NUM_POINTS] = torch.tensor([[len(sight.points)]])
        else:
            state[keys.DEPTH] = _row(cast(np.ndarray, sight.depth))
            state[keys.MASK] = torch.from_numpy(np.ascontiguousarray(sight.mask))[None]
        state = self.view.look(state, begins=self.steps == 0)
        self.num_points = int(state.get(keys.NUM_POINTS, torch.zeros(1)).sum())
        return state

    def note(self, sight: Sight, T_base_ee: np.ndarray, age: float, *, acted: bool, period: float) -> None:
        """Count a step that was taken, and remember where the target was seen."""
        self.steps += acted
        if acted and sight.shows_target:
            self.age, self.T_base_seen = age, T_base_ee
        else:
            self.age += period


def _into_hand(sight: Sight, T_base_ee: np.ndarray, T_base_camera: np.ndarray | None, frame: Frame) -> Sight:
    """A cloud of `frame` in the hand's frame."""
    if sight.points is None or frame == "ee":
        return sight
    if frame == "camera" and T_base_camera is None:
        raise ConfigError(
            "frame='camera', and nothing tells where the camera is: give T_ee_camera or T_base_camera to "
            "GraspAgent, or T_base_camera to each act."
        )
    T_base_points = T_base_camera if frame == "camera" else np.eye(4)
    T_ee_points = np.linalg.solve(T_base_ee, cast(np.ndarray, T_base_points))
    return Sight(points=(sight.points @ T_ee_points[:3, :3].T + T_ee_points[:3, 3]).astype(np.float32))


def _row(array: np.ndarray) -> Tensor:
    """(1, ...) float32."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))[None]


def _pose(convert: Any, numbers: Tensor) -> np.ndarray:
    return convert(numbers.double()).numpy()


def _read_numbers(name: str, value: Any) -> np.ndarray:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} cannot be read as numbers ({error}).") from error
    if not np.isfinite(numbers).all():
        raise ConfigError(f"{name} has NaN or infinity: the robot's state is not known, do not move.")
    return numbers


def _read_pose(name: str, value: Any, num_arms: int | None = None) -> np.ndarray:
    """Rigid poses, (4, 4) or (N, 4, 4)."""
    pose = _read_numbers(name, value)
    shape = (4, 4) if num_arms is None else (num_arms, 4, 4)
    if pose.shape != shape:
        raise ConfigError(f"{name} of shape {pose.shape}: give {shape}.")
    turn = pose[..., :3, :3]
    rigid = np.abs(turn @ turn.swapaxes(-1, -2) - np.eye(3)).max() < 1e-3 and (np.linalg.det(turn) > 0).all()
    if not rigid or np.abs(pose[..., 3, :] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
        raise ConfigError(
            f"{name} is no rigid pose: give a rotation, a translation in metres and the row 0 0 0 1."
        )
    return pose
