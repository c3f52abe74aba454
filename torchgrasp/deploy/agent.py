"""GraspAgent: from a camera's pictures and an arm's joints to the next pose of its hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.config.trained_policy import TrainedPolicy, load_policy
from torchgrasp.config.trained_view import check_action_space, make_view, training_lens
from torchgrasp.deploy.arguments import each_arm, read_ages, read_arms, read_poses, read_rows
from torchgrasp.deploy.arm_episode import ArmEpisode
from torchgrasp.deploy.command import GraspCommand
from torchgrasp.deploy.sight import FRAMES, Frame, Sight, choose_thin, into_hand, read_cloud, read_picture
from torchgrasp.errors import ConfigError, PictureError, check_range, check_whole
from torchgrasp.geometry import ACTION_BOUND, ACTION_SIZE, action_to_pose, goal_to_pose, pose_to_action
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim.control import TABLE_GUARD

OnProblem = Literal["hold", "look", "raise"]
_ON_PROBLEM = ("hold", "look", "raise")


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
            it last saw the target (``look``), by a step's length at most each time, or PictureError is raised
            (``raise``). Such a step does not count.
        max_age: seconds; an older picture is not used, and never moves the hand.
        holes_are_empty: whether a pixel without a return means that nothing stands within range, as in
            simulation. A real sensor has holes.
        thin: every so many rows and columns of a picture are used; None for pixels twice as fine as those of
            training.
        period: seconds of a control period, which a `ClosedLoop` keeps; that of training is 0.15.
        trust: see `torchgrasp.load_policy`.
        device: of the network.

    Raises:
        ConfigError: where an argument is impossible, or the policy's actions are of another action space
            than `ee_delta`.

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
        if not isinstance(intrinsics, CameraIntrinsics | None):
            raise ConfigError(
                f"intrinsics of type {type(intrinsics).__name__}: give CameraIntrinsics; of a matrix K, "
                "CameraIntrinsics.from_matrix(K, width=..., height=...)."
            )
        if T_ee_camera is not None and T_base_camera is not None:
            raise ConfigError(
                "T_ee_camera and T_base_camera are both given: a camera is on the hand, or stands still."
            )
        trained = policy if isinstance(policy, TrainedPolicy) else load_policy(policy, trust=trust)
        check_action_space(trained)
        self.policy = _on_device(trained, torch.device(device))
        self.horizon = trained.horizon
        self.num_arms, self.on_problem, self.max_age = num_arms, on_problem, max_age
        self.table_height, self.period, self.holes_are_empty = float(table_height), period, holes_are_empty
        self._hand_camera = None if T_ee_camera is None else read_poses("T_ee_camera", T_ee_camera)
        self._static_camera = None if T_base_camera is None else read_poses("T_base_camera", T_base_camera)
        self.intrinsics, self._thin = intrinsics, 1
        if intrinsics is not None:
            self._thin = choose_thin(intrinsics, training_lens(trained)) if thin is None else thin
            check_whole("thin", self._thin, 1, min(intrinsics.width, intrinsics.height))
        seen = None if intrinsics is None else intrinsics.thin_out(self._thin)
        self._arms = [
            ArmEpisode(row, make_view(trained, intrinsics=seen, table_height=self.table_height), self.horizon)
            for row in range(num_arms or 1)
        ]
        self._device = torch.device(device)

    def reset(self, arms: Sequence[int] | None = None) -> None:
        """Begin an episode of all arms, or of those named: nothing has been seen, all T steps are left."""
        rows = range(len(self._arms)) if arms is None else read_rows(arms, len(self._arms))
        for row in rows:
            self._arms[row].reset()

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
        """The next step of each arm. Arrays may be numpy's or torch's, of any floating type.

        Args:
            depth: (*, H, W) metres as floats, or millimetres as 16-bit whole numbers; 0 and NaN are holes,
                and so is what is nearer than the camera's `near`.
            mask: (*, H, W) bool or whole numbers, not zero at the target's pixels, of any segmenter.
            points: (*, n, 3) the target's points in place of pictures, metres; for N arms a sequence of N
                clouds.
            frame: of the points: ``ee``, ``camera`` or ``base``.
            joints: (*, 7) angles of a Panda's or FR3's arm in radians, or (*, 9) with both fingers in metres.
                The hand's pose follows from them where it is not given.
            T_base_ee: (*, 4, 4) pose of the hand when the picture was taken.
            T_base_camera: (*, 4, 4) pose of the camera then, in place of what the agent was told.
            age: seconds since the picture was taken, of all arms or (N,).

        Raises:
            ConfigError: where the call is wrong: arguments of a wrong shape, or too few of them; where every
                arm's episode is over; and where the policy gives no finite action.
            PictureError: where a picture cannot be used and `on_problem` is ``raise``.
        """
        if all(arm.over for arm in self._arms):
            raise ConfigError(f"The episode of {self._tell_over()}")
        q, hands = read_arms(joints, T_base_ee, self.num_arms)
        cameras = self._find_cameras(T_base_camera, hands)
        ages = read_ages(age, len(self._arms))
        sights = self._look(depth, mask, points, frame, hands, cameras)
        problems = [self._find_problem(*each) for each in zip(self._arms, sights, ages.tolist(), strict=True)]
        if self.on_problem == "raise":
            for arm, problem in zip(self._arms, problems, strict=True):
                if problem is not None and not arm.over:
                    raise PictureError(f"{problem}: take another picture, or stop.")
        acting = [row for row, problem in enumerate(problems) if problem is None]
        actions = np.zeros((len(hands), ACTION_SIZE), dtype=np.float32)
        goals = np.full((len(hands), 4, 4), np.nan)
        if acting:
            states = [self._arms[row].see(sights[row], hands[row], cameras[row], q[row]) for row in acting]
            actions[acting], goals[acting] = self._ask(states, hands[acting])
        # Who looks again. An old picture does not tell how things stand, so that nothing moves by it.
        back = [row for row, arm in enumerate(self._arms) if self._goes_back(arm, problems[row], ages[row])]
        for row in back:
            actions[row] = _step_towards(self._arms[row].T_base_seen, hands[row])
        for row, arm in enumerate(self._arms):
            arm.note(sights[row], hands[row], ages[row], acted=row in acting, period=self.period)
        targets, moving = hands.copy(), [*acting, *back]
        targets[moving] = self._raise(
            hands[moving] @ _pose(action_to_pose, torch.from_numpy(actions[moving]))
        )
        closing = [row in acting and arm.over for row, arm in enumerate(self._arms)]
        told = {
            "T_base_ee": targets,
            "action": actions,
            "close": np.array(closing),
            "goal": goals,
            "num_points": np.array([arm.num_points for arm in self._arms]),
            "age": np.array([arm.age for arm in self._arms]),
        }
        if self.num_arms is None:
            told = {name: each[0] for name, each in told.items()}
        return GraspCommand(**told, problems=tuple(problems))

    def _tell_over(self) -> str:
        return f"{self.horizon} steps is over: close the fingers, lift, and call reset before the next."

    def _find_cameras(self, T_base_camera: Any, hands: np.ndarray) -> list[np.ndarray] | list[None]:
        """(4, 4) pose of each arm's camera, None where nothing tells it."""
        if T_base_camera is not None:
            return list(read_poses("T_base_camera", T_base_camera, self.num_arms))
        if self._static_camera is not None:
            return list(np.broadcast_to(self._static_camera, hands.shape))
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
            clouds = [read_cloud(each) for each in each_arm("points", points, self.num_arms)]
            return [into_hand(*each, frame) for each in zip(clouds, hands, cameras, strict=True)]
        if depth is None or mask is None or points is not None:
            raise ConfigError("depth and mask belong together: give both, and no points beside them.")
        if any(camera is None for camera in cameras):
            raise ConfigError(
                "Nothing tells where the camera is: give T_ee_camera or T_base_camera to GraspAgent, or "
                "T_base_camera to each act."
            )
        pictures = zip(
            each_arm("depth", depth, self.num_arms), each_arm("mask", mask, self.num_arms), strict=True
        )
        options: Any = {"thin": self._thin, "holes_are_empty": self.holes_are_empty}
        return [read_picture(*each, self.intrinsics, **options) for each in pictures]

    def _find_problem(self, arm: ArmEpisode, sight: Sight, age: float) -> str | None:
        if arm.over:
            return f"the episode of {self._tell_over()}"
        if age > self.max_age:
            return f"the picture is {age:.2f} s old, more than max_age={self.max_age}"
        if sight.problem is None and not sight.shows_target and arm.T_base_seen is None:
            return "no point of the target has been seen yet"
        return sight.problem

    def _goes_back(self, arm: ArmEpisode, problem: str | None, age: float) -> bool:
        """Whether an arm returns to where it last saw the target."""
        may = self.on_problem == "look" and problem is not None and not arm.over and age <= self.max_age
        return may and arm.T_base_seen is not None

    def _ask(self, states: list[TensorDictBase], hands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The policy's actions (M, 6) within their bounds, and its goals (M, 4, 4) in the base."""
        batch: Any = torch.cat(states)  # pyright: ignore[reportArgumentType, reportCallIssue]
        out = self.policy(batch.to(self._device)).cpu()
        action = out[keys.ACTION].numpy()
        if not np.isfinite(action).all():
            raise ConfigError(
                "The policy's action has NaN or infinity: do not move. Its weights are damaged, or it was "
                "shown what it was never trained for."
            )
        goal = out.get(keys.GOAL_PREDICTION, None)
        goals = np.nan if goal is None else hands @ _pose(goal_to_pose, goal)
        return _bounded(action), np.broadcast_to(goals, hands.shape)

    def _raise(self, hands: np.ndarray) -> np.ndarray:
        """Hand poses (N, 4, 4) above the table, as training's controller holds them."""
        lowest = lowest_point(hands) - self.table_height
        hands[:, 2, 3] += np.maximum(0.0, TABLE_GUARD - lowest)
        return hands


def _on_device(policy: TrainedPolicy, device: torch.device) -> TrainedPolicy:
    """The policy there; its owner's stays where it is."""
    there = all(each.device == device for each in policy.parameters())
    return policy if there else deepcopy(policy).to(device)


def _step_towards(T_base_target: np.ndarray | None, T_base_ee: np.ndarray) -> np.ndarray:
    """(6,) action that goes to a hand pose as far as one step goes."""
    assert T_base_target is not None
    return _bounded(pose_to_action(torch.from_numpy(np.linalg.solve(T_base_ee, T_base_target))).numpy())


def _bounded(action: np.ndarray) -> np.ndarray:
    """Actions (*, 6) as the environment takes them."""
    return np.clip(action, -np.array(ACTION_BOUND), ACTION_BOUND).astype(np.float32)


def _pose(convert: Any, numbers: Tensor) -> np.ndarray:
    return convert(numbers.double()).numpy()
