"""A grasping policy where there is no torch: from depth, mask and joints to the hand's next pose.

`torchgrasp export` writes this file as `grasp_policy.py` beside the network (`.onnx`) and its settings
(`.json`). It needs numpy and onnxruntime alone, and makes of a picture what torchgrasp's transforms make of
it, with the same random draws. From a shell, `python grasp_policy.py policy.json` says what the policy reads.

    policy = GraspPolicy("policy.json", camera={"width": 848, "height": 480, "fx": 612.3}, T_ee_camera=X)
    policy.reset()
    step = policy.act(depth, mask, joints=q)    # step.T_base_ee, step.close, step.goal, step.problem
"""

from __future__ import annotations

import json
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

FORMAT = 1
_UNKNOWN = 1e-3  # metres: where a sensor tells nothing, something may stand right before it
_TICKS = 1_000_000
_ROUNDING = 1e-9
_SHIFTS, _SLOWING = 3, 0.85  # of a target out of sight, see AggregatePoints


class PolicyError(ValueError):
    """A file or call that cannot be used; the message says what to do."""


@dataclass(frozen=True)
class Step:
    """What the arm is to do next.

    Attributes:
        T_base_ee: (4, 4) pose that the hand is to reach in one control period, base frame, metres.
        action: (6,) the same relative to the hand: metres and intrinsic XYZ Euler angles.
        close: whether the fingers close there.
        goal: (4, 4) the grasp that the policy has in mind, base frame; NaN where it tells none.
        num_points: of the target that the policy was shown; 1, a guess, once all of them have gone.
        problem: why the hand stays where it is, and the step does not count; None where the policy acts.
    """

    T_base_ee: np.ndarray
    action: np.ndarray
    close: bool
    goal: np.ndarray
    num_points: int
    problem: str | None = None


class Camera:
    """A pinhole camera in OpenCV axes; pixels, metres. The centre of the first pixel is at (0, 0)."""

    def __init__(
        self,
        *,
        width: int,
        height: int,
        fx: float,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        near: float = 0.035,
        far: float = 2.0,
    ) -> None:
        self.width, self.height = int(width), int(height)
        self.focal = (float(fx), float(fx if fy is None else fy))
        self.centre = (width / 2 if cx is None else cx + 0.5, height / 2 if cy is None else cy + 0.5)
        self.near, self.far = float(near), float(far)
        if not (self.width > 0 and self.height > 0 and min(self.focal) > 0 and 0 <= self.near < self.far):
            raise PolicyError(
                f"camera of {width} x {height} pixels, fx={fx}, fy={fy}, near={near}, far={far} cannot be: "
                "give sizes and focal lengths above 0, and near below far."
            )

    def thin_out(self, step: int) -> Camera:
        """The camera of a picture of which every `step`-th row and column is kept."""
        fx, fy = (each / step for each in self.focal)
        cx, cy = ((each - 0.5) / step for each in self.centre)
        size = {"width": -(-self.width // step), "height": -(-self.height // step)}
        return Camera(**size, fx=fx, fy=fy, cx=cx, cy=cy, near=self.near, far=self.far)

    def rays(self) -> np.ndarray:
        """(height * width, 3) float32 directions through the pixels' centres, z = 1."""
        u = (np.arange(self.width) + 0.5 - self.centre[0]) / self.focal[0]
        v = (np.arange(self.height) + 0.5 - self.centre[1]) / self.focal[1]
        grid = np.stack(np.meshgrid(u, v), axis=-1)
        rays = np.concatenate((grid, np.ones((*grid.shape[:2], 1))), axis=-1)
        return rays.reshape(-1, 3).astype(np.float32)


class _Draws:
    """Random generators that follow from a seed and the moment of an episode."""

    def __init__(self, seed: int, purpose: str) -> None:
        words = [seed & 0xFFFFFFFF]
        while seed := seed >> 32:
            words.append(seed & 0xFFFFFFFF)
        self._key = (*words, zlib.crc32(purpose.encode()))

    def __call__(self, moment: dict[str, Any]) -> np.random.Generator:
        ticks = max(0, int(np.rint(moment["time_left"][0] * _TICKS)))
        stream = (0, moment["episode"], ticks)  # of world 0
        return np.random.default_rng(np.array((*self._key, *stream), dtype=np.uint32))


class _DepthToPoints:
    """The target's pixels as points of the hand's frame."""

    def __init__(self, camera: Camera, **_: Any) -> None:
        self._rays = camera.rays()

    def begin(self) -> None:
        """It remembers nothing."""

    def __call__(self, seen: dict[str, Any]) -> None:
        T_base_ee, T_base_camera = seen["T_base_ee"], seen["T_base_camera"]
        index = np.flatnonzero(seen["mask"])
        z = seen["depth"].reshape(-1).take(index)
        if (z <= 0).any():
            index, z = index[z > 0], z[z > 0]
        to_ee = T_base_ee[:3, :3].T @ T_base_camera[:3]
        to_ee[:, 3] -= T_base_ee[:3, :3].T @ T_base_ee[:3, 3]
        rays = self._rays.take(index, axis=0)
        seen["points"] = ((rays * z[:, None]) @ to_ee[:, :3].T + to_ee[:, 3]).astype(np.float32)
        seen["num_points"] = len(index)


class _AggregatePoints:
    """All views of the episode in today's hand frame."""

    def __init__(
        self, camera: Camera, *, alpha: float, max_points: int, carve: float | None, seed: int, **_: Any
    ) -> None:
        self._camera, self._alpha, self._max_points, self._carve = camera, alpha, max_points, carve
        self._draws = _Draws(seed, "AggregatePoints")
        self.begin()

    def begin(self) -> None:
        """Forget the episode."""
        self._views, self._points = 0, np.ones((0, 4), dtype=np.float32)
        self._place, self._pace, self._shifts, self._seen_at = None, np.zeros(4), [], -1
        self._has_gone = False

    def __call__(self, seen: dict[str, Any]) -> None:
        rng, pose = self._draws(seen), seen["T_base_ee"]
        if self._carve is not None:
            through = self._find_seen_through(seen["depth"], seen["T_base_camera"], self._carve)
            self._points = self._points[~through]
        self._add_view(seen["points"], pose, rng)
        place, gone = self._place, self._has_gone or not len(self._points)
        if self._carve is not None and place is not None and gone and self._seen_at < self._views:
            self._pace = _SLOWING * self._pace
            self._place = self._points = (place + self._pace).astype(np.float32)
            self._has_gone = True
        inverse = np.concatenate((pose[:3, :3], -pose[:3, 3:].T @ pose[:3, :3]))
        seen["points"] = self._points @ inverse
        seen["num_points"] = len(self._points)

    def _add_view(self, seen: np.ndarray, pose: np.ndarray, rng: np.random.Generator) -> None:
        drawn = int(np.ceil(self._alpha**self._views * len(seen) - _ROUNDING))
        self._views += 1
        moved = seen @ pose[:3, :3].T + pose[:3, 3]
        rows = np.concatenate((moved, np.ones((len(moved), 1))), axis=1).astype(np.float32)
        if len(rows):
            self._find(rows)
        if drawn < len(rows):
            rows = rows.take(rng.permutation(len(rows))[:drawn], axis=0)
        self._points = np.concatenate((self._points, rows))
        if len(self._points) > self._max_points:
            self._points = self._points[rng.permutation(len(self._points))[: self._max_points]]

    def _find(self, rows: np.ndarray) -> None:
        """Where the target is, and how it goes on once it is out of sight."""
        place = rows.mean(axis=0, keepdims=True)
        followed = self._place is not None and self._seen_at == self._views - 1
        self._shifts = [*self._shifts, place - self._place][-_SHIFTS:] if followed else []
        self._place, self._seen_at = place, self._views
        self._pace = max(self._shifts, key=np.linalg.norm, default=np.zeros_like(place))
        if self._has_gone:
            self._points, self._has_gone = self._points[:0], False

    def _find_seen_through(self, depth: np.ndarray, T_base_camera: np.ndarray, carve: float) -> np.ndarray:
        height, width = depth.shape
        x, y, z = ((self._points[:, :3] - T_base_camera[:3, 3]) @ T_base_camera[:3, :3]).T
        ahead = np.maximum(z, 1e-6)
        (fx, fy), (cx, cy) = self._camera.focal, self._camera.centre
        u = np.floor(fx * x / ahead + cx)
        v = np.floor(fy * y / ahead + cy)
        inside = (z > 1e-6) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        nearest = _smallest_around(np.where(depth > 0, depth, np.inf))
        behind = nearest[np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)]
        return inside & (z + carve < behind)


class _SamplePoints:
    """A fixed number of points for the network."""

    def __init__(self, camera: Camera, *, num_points: int, seed: int, **_: Any) -> None:
        self._num_points, self._draws = num_points, _Draws(seed, "SamplePoints")

    def begin(self) -> None:
        """It remembers nothing."""

    def __call__(self, seen: dict[str, Any]) -> None:
        out, n = np.zeros((self._num_points, 3), dtype=np.float32), seen["num_points"]
        if n:
            rng = self._draws(seen)
            index = rng.permutation(n)[: self._num_points]
            if n < self._num_points:
                index = np.concatenate((index, rng.integers(n, size=self._num_points - n)))
            out[:] = seen["points"].take(index, axis=0)
        seen["points"], seen["num_points"] = out, min(n, self._num_points)


class _AppendGripperPoints:
    """The hand itself as marked points of the cloud."""

    def __init__(self, camera: Camera, *, marked: list, **_: Any) -> None:
        self._marked = np.array(marked, dtype=np.float32)

    def begin(self) -> None:
        """It remembers nothing."""

    def __call__(self, seen: dict[str, Any]) -> None:
        flagged = np.concatenate((seen["points"], np.zeros_like(seen["points"][:, :1])), axis=1)
        seen["points"] = np.concatenate((flagged, self._marked))


class _TablePlane:
    """The table in the hand's frame."""

    def __init__(self, camera: Camera, *, table_height: float, **_: Any) -> None:
        self._height = table_height

    def begin(self) -> None:
        """It remembers nothing."""

    def __call__(self, seen: dict[str, Any]) -> None:
        seen["table_plane"] = seen["T_base_ee"][2].copy()
        seen["table_plane"][3] -= self._height


class _WristAngle:
    """The angle of the arm's last joint."""

    def __init__(self, camera: Camera, **_: Any) -> None:
        pass

    def begin(self) -> None:
        """It remembers nothing."""

    def __call__(self, seen: dict[str, Any]) -> None:
        seen["wrist_angle"] = seen["joints"][6:7]


TRANSFORMS: dict[str, Any] = {
    "DepthToPoints": _DepthToPoints,
    "AggregatePoints": _AggregatePoints,
    "SamplePoints": _SamplePoints,
    "AppendGripperPoints": _AppendGripperPoints,
    "TablePlane": _TablePlane,
    "WristAngle": _WristAngle,
}

# What the settings tell each of them, and the input of the network that it makes.
_OPTIONS: dict[str, tuple[str, ...]] = {
    "AggregatePoints": ("alpha", "max_points", "carve", "seed"),
    "SamplePoints": ("num_points", "seed"),
    "AppendGripperPoints": ("marked",),
}
_MAKES = {"DepthToPoints": "points", "TablePlane": "table_plane", "WristAngle": "wrist_angle"}
# Settings that are whole numbers, and the least of each; shapes of those that are no single number.
_LEAST = {"horizon": 1, "width": 1, "height": 1, "max_points": 1, "num_points": 1, "seed": 0}
_SHAPES: dict[str, tuple[int, ...]] = {
    "action_bound": (6,),
    "hand_boxes": (-1, 4),
    "marked": (-1, 4),
    "joints": (7, 4, 4),
    "hand": (4, 4),
    "lowest": (7,),
    "highest": (7,),
}


class GraspPolicy:
    """A trained policy for one camera and arm.

    Args:
        settings: the `.json` file; the network lies beside it.
        camera: `width`, `height`, `fx` and, where they differ, `fy`, `cx`, `cy`, `near`, `far`, as
            calibration tells them; the camera of training if None.
        T_ee_camera: (4, 4) pose of a camera on the hand. Without it each `act` is given `T_base_camera`.
        table_height: of the table above the base's origin, metres.
        max_age: seconds; an older picture is not used.
        holes_are_empty: whether a pixel without a return means that nothing stands within range.
        thin: every so many rows and columns are used; None for pixels twice as fine as those of training.

    Raises:
        PolicyError: where a file is missing or damaged, or an argument is impossible.
    """

    def __init__(
        self,
        settings: str | Path = "policy.json",
        *,
        camera: dict[str, Any] | None = None,
        T_ee_camera: Any = None,
        table_height: float = 0.0,
        max_age: float = 0.5,
        holes_are_empty: bool = False,
        thin: int | None = None,
    ) -> None:
        file = Path(settings)
        self.settings = _read_settings(file)
        self.horizon: int = self.settings["horizon"]
        try:
            self.camera = Camera(**(self.settings["camera"] if camera is None else camera))
        except PolicyError:
            raise
        except (TypeError, ValueError) as error:
            raise PolicyError(f"camera={camera}: give width, height and fx ({error}).") from error
        finest = _choose_thin(self.camera, Camera(**self.settings["camera"]))
        self._thin = finest if thin is None else thin
        if int(self._thin) != self._thin or not 1 <= self._thin <= min(self.camera.width, self.camera.height):
            raise PolicyError(f"thin={thin} is out of range: give a whole number from 1 on.")
        self._hand_camera = None if T_ee_camera is None else _read_pose("T_ee_camera", T_ee_camera)
        self._max_age, self._holes_are_empty = _read_number("max_age", max_age, 0.0), holes_are_empty
        self._table_height = _read_number("table_height", table_height, -10.0)
        lens = self.camera.thin_out(self._thin)
        self._transforms = [
            TRANSFORMS[each["name"]](lens, **{**each, "table_height": self._table_height})
            for each in self.settings["transforms"]
        ]
        names = self.settings["inputs"], self.settings["outputs"]
        self._session = _open_network(file.parent / self.settings["network"], *names)
        self._episode = -1
        self.reset()

    def reset(self) -> None:
        """Begin an episode: nothing has been seen, all steps are left."""
        if self._episode < 0 or self.steps:
            self._episode += 1
        self.steps, self._has_seen = 0, False
        for each in self._transforms:
            each.begin()

    def act(
        self,
        depth: Any,
        mask: Any,
        *,
        joints: Any = None,
        T_base_ee: Any = None,
        T_base_camera: Any = None,
        age: float = 0.0,
    ) -> Step:
        """The next step.

        Args:
            depth: (H, W) metres as floats, or millimetres as 16-bit whole numbers; 0 and NaN are holes.
            mask: (H, W) bool or whole numbers, not zero at the target's pixels.
            joints: (7,) or (9,) angles of a Panda's or FR3's arm, radians.
            T_base_ee: (4, 4) pose of the hand when the picture was taken; follows from joints if None.
            T_base_camera: (4, 4) pose of the camera then, in place of `T_ee_camera`.
            age: seconds since the picture was taken.

        Raises:
            PolicyError: where the call is wrong, the episode is over, or the network gives no number.
        """
        if self.steps >= self.horizon:
            raise PolicyError(
                f"The episode of {self.horizon} steps is over: close the fingers, lift, and call reset."
            )
        age = _read_number("age", age, 0.0)
        seen, hand = self._read_arm(joints, T_base_ee)
        camera = self._find_camera(T_base_camera, hand)
        depth, mask, problem = self._read_picture(depth, mask)
        if age > self._max_age:
            problem = f"the picture is {age:.2f} s old, more than max_age={self._max_age}"
        if problem is None and not self._has_seen and not mask.any():
            problem = "no point of the target has been seen yet"
        if problem is not None:
            return Step(hand, np.zeros(6, np.float32), False, np.full((4, 4), np.nan), 0, problem)
        left = np.array([1.0 - self.steps / self.horizon], dtype=np.float32)
        seen |= {"depth": depth, "mask": mask, "T_base_camera": camera.astype(np.float32)}
        seen |= {"time_left": left, "episode": self._episode}
        return self._step(seen, hand, shows_target=bool(mask.any()))

    def _step(self, seen: dict[str, Any], hand: np.ndarray, *, shows_target: bool) -> Step:
        for each in self._transforms:
            each(seen)
        inputs = {name: np.asarray(seen[name], np.float32)[None] for name in self.settings["inputs"]}
        said = dict(zip(self.settings["outputs"], self._session.run(None, inputs), strict=True))
        bound = np.array(self.settings["action_bound"])
        action = np.asarray(said["action"][0])
        if not np.isfinite(action).all():
            raise PolicyError("The policy's action has NaN or infinity: do not move.")
        action = np.clip(action, -bound, bound).astype(np.float32)
        goal = np.full((4, 4), np.nan)
        if "goal_prediction" in said:
            goal = hand @ _goal_to_pose(np.asarray(said["goal_prediction"][0], np.float64))
        self.steps += 1
        self._has_seen |= shows_target
        target = self._raise(hand @ _action_to_pose(action.astype(np.float64)))
        return Step(target, action, self.steps == self.horizon, goal, int(seen.get("num_points", 0)))

    def _read_arm(self, joints: Any, T_base_ee: Any) -> tuple[dict[str, Any], np.ndarray]:
        if joints is None and T_base_ee is None:
            raise PolicyError("joints and T_base_ee are both missing: give one, from the same moment.")
        if joints is None and "wrist_angle" in self.settings["inputs"]:
            raise PolicyError("The policy needs joints, which were not given.")
        seen: dict[str, Any] = {}
        if joints is not None:
            q = _read_numbers("joints", joints)
            if q.shape not in ((7,), (9,)):
                raise PolicyError(f"joints of shape {q.shape}: give (7,), or (9,) with fingers.")
            seen["joints"] = q.astype(np.float32)
            if T_base_ee is None:
                T_base_ee = self._find_hand(q[:7])
        hand = _read_pose("T_base_ee", T_base_ee)
        return {**seen, "T_base_ee": hand.astype(np.float32)}, hand

    def _find_hand(self, q: np.ndarray) -> np.ndarray:
        """(4, 4) pose of a Panda's hand at the joint angles (7,)."""
        arm = self.settings["arm"]
        outside = np.flatnonzero((q < arm["lowest"]) | (q > arm["highest"]))
        if len(outside):
            first = int(outside[0])
            raise PolicyError(
                f"joints: joint {first + 1} cannot stand at {q[first]:.3f} rad on a Panda or FR3: give the "
                "arm's own angles in radians, or T_base_ee for another arm."
            )
        pose = np.eye(4)
        for angle, frame in zip(q, arm["joints"], strict=True):
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            pose = pose @ np.array(frame) @ turn
        return pose @ np.array(arm["hand"])

    def _find_camera(self, T_base_camera: Any, hand: np.ndarray) -> np.ndarray:
        if T_base_camera is not None:
            return _read_pose("T_base_camera", T_base_camera)
        if self._hand_camera is None:
            raise PolicyError(
                "Nothing tells where the camera is: give T_ee_camera to GraspPolicy, or T_base_camera to act."
            )
        return hand @ self._hand_camera

    def _read_picture(self, depth: Any, mask: Any) -> tuple[np.ndarray, np.ndarray, str | None]:
        """Depth in metres and the target's pixels that have one, thinned out, and what is wrong with them."""
        depth, mask = _as_picture("depth", depth), _as_picture("mask", mask)
        if depth.dtype.kind in "iub" and depth.dtype.itemsize != 2:
            raise PolicyError(f"depth of type {depth.dtype}: give metres as floats, or 16-bit millimetres.")
        if mask.dtype.kind == "f" and not np.isin(mask, (0.0, 1.0)).all():
            raise PolicyError("mask has values between 0 and 1, or NaN: give bool, as by probability > 0.5.")
        camera = self.camera
        for name, picture in (("depth", depth), ("mask", mask)):
            if picture.shape != (camera.height, camera.width):
                told = f"{name} of {picture.shape[1]} x {picture.shape[0]} pixels, where the camera has "
                return depth, mask, f"{told}{camera.width} x {camera.height}"
        depth, mask = depth[:: self._thin, :: self._thin], mask[:: self._thin, :: self._thin] != 0
        depth = depth * np.float32(1e-3) if depth.dtype.kind in "iu" else depth.astype(np.float32)
        with np.errstate(invalid="ignore"):
            there = np.isfinite(depth) & (depth > 0) & (depth >= camera.near)
            within = there & (depth <= camera.far)
        problem = None
        if not there.any():
            problem = "depth has no return at any pixel"
        elif mask.any() and not (mask & there).any():
            problem = "depth has no return at the target's pixels"
        elif mask.any() and not (mask & within).any():
            problem = f"the target's pixels lie beyond far={camera.far} m (depth as floats is in metres)"
        filled = np.where(there, depth, np.float32(0.0 if self._holes_are_empty else _UNKNOWN))
        return filled, mask & within, problem

    def _raise(self, hand: np.ndarray) -> np.ndarray:
        """A hand pose above the table."""
        x, y, z = hand[2, :3]
        lowest = min(
            -half_x * abs(x) - outer * abs(y) + min(z * rear, z * front)
            for half_x, outer, rear, front in self.settings["hand_boxes"]
        )
        hand[2, 3] += max(0.0, self.settings["table_guard"] - (hand[2, 3] + lowest - self._table_height))
        return hand


def _choose_thin(camera: Camera, training: Camera) -> int:
    """Every so many rows and columns are kept, of pixels at least twice as fine as those of training."""
    return max(1, int(min(camera.focal) / (2 * min(training.focal))))


def _smallest_around(picture: np.ndarray) -> np.ndarray:
    """(H, W) the smallest of each pixel and its eight neighbours."""
    height, width = picture.shape
    padded = np.pad(picture, 1, mode="edge")
    rows = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    assert rows.shape == (height, width + 2)
    return np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])


def _action_to_pose(action: np.ndarray) -> np.ndarray:
    """(6,) metres and intrinsic XYZ Euler angles to (4, 4)."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(action[3:]), np.sin(action[3:])
    pose = np.eye(4)
    pose[:3, :3] = [
        [cb * cc, -cb * sc, sb],
        [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
        [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
    ]
    pose[:3, 3] = action[:3]
    return pose


def _goal_to_pose(goal: np.ndarray) -> np.ndarray:
    """(7,) metres and quaternion xyzw to (4, 4)."""
    unit = goal[3:] / max(float(np.linalg.norm(goal[3:])), 1e-6)
    pose = np.eye(4)
    for axis in range(3):
        normal = np.cross(unit[:3], np.eye(3)[axis])
        pose[:3, axis] += 2.0 * (unit[3] * normal + np.cross(unit[:3], normal))
    pose[:3, 3] = goal[:3]
    return pose


def _read_numbers(name: str, value: Any) -> np.ndarray:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PolicyError(f"{name} cannot be read as numbers ({error}).") from error
    if not np.isfinite(numbers).all():
        raise PolicyError(f"{name} has NaN or infinity: the robot's state is not known, do not move.")
    return numbers


def _read_number(name: str, value: Any, lowest: float) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise PolicyError(f"{name}={value!r} is no number ({error}).") from error
    if not lowest <= number < float("inf"):
        raise PolicyError(f"{name}={value} is out of range: give a number of at least {lowest:g}.")
    return number


def _read_pose(name: str, value: Any) -> np.ndarray:
    pose = _read_numbers(name, value)
    if pose.shape != (4, 4):
        raise PolicyError(f"{name} of shape {pose.shape}: give (4, 4).")
    turn = pose[:3, :3]
    rigid = np.abs(turn @ turn.T - np.eye(3)).max() < 1e-3 and np.linalg.det(turn) > 0
    if not rigid or np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
        raise PolicyError(
            f"{name} is no rigid pose: give a rotation, a translation in metres and the row 0 0 0 1."
        )
    return pose


def _as_picture(name: str, picture: Any) -> np.ndarray:
    try:
        picture = np.asarray(picture)
    except ValueError as error:
        raise PolicyError(f"{name} cannot be read as a picture ({error}).") from error
    if picture.ndim != 2 or picture.dtype.kind not in "fiub":
        raise PolicyError(f"{name} of shape {picture.shape} and type {picture.dtype}: give (H, W) numbers.")
    return picture


def _read_settings(file: Path) -> dict[str, Any]:
    """What stands in the file, and whether this runner can do all of it."""
    again = "export the policy again"
    try:
        settings = json.loads(file.read_text())
        if settings["format"] != FORMAT:
            raise PolicyError(f"{file} is of format {settings['format']}, not {FORMAT}: {again}.")
        for each in settings["transforms"]:
            if each["name"] not in TRANSFORMS:
                raise PolicyError(f"{file} has the transform {each['name']!r}, unknown here: {again}.")
        names = ("horizon", "camera", "network", "inputs", "outputs", "action_bound", "arm", "hand_boxes")
        if missing := [name for name in (*names, "table_guard") if name not in settings]:
            raise PolicyError(f"{file} does not tell {missing[0]}: {again}.")
        _check_settings(settings)
    except PolicyError:
        raise
    except OSError as error:
        raise PolicyError(f"{file} cannot be read ({error.strerror}): {again}.") from error
    except (KeyError, TypeError, ValueError) as error:
        raise PolicyError(f"{file} is damaged ({error!r}): {again}.") from error
    name = settings["network"]
    if not isinstance(name, str) or Path(name).name != name:
        raise PolicyError(f"{file} names the network {name!r}, which does not lie beside it: {again}.")
    return settings


def _check_settings(settings: dict[str, Any]) -> None:
    """Raise KeyError, TypeError or ValueError where a number or name is missing, or is none."""
    _check_numbers(settings, ("horizon", "action_bound", "table_guard", "hand_boxes"))
    _check_numbers(settings["camera"], ("width", "height", "fx", "fy", "cx", "cy", "near", "far"))
    _check_numbers(settings["arm"], ("joints", "hand", "lowest", "highest"))
    for each in settings["transforms"]:
        _check_numbers(each, _OPTIONS.get(each["name"], ()))
    made = {_MAKES.get(each["name"]) for each in settings["transforms"]}
    if strange := [name for name in settings["inputs"] if name not in made | {"time_left"}]:
        raise ValueError(f"no transform makes the input {strange[0]}")
    if "action" not in settings["outputs"]:
        raise ValueError("no output is the action")


def _check_numbers(told: dict[str, Any], names: tuple[str, ...]) -> None:
    for name in names:
        value = told[name]
        if name in _LEAST:
            fits = type(value) is int and value >= _LEAST[name]
        elif name == "carve" and value is None:
            fits = True
        else:
            numbers, shape = np.asarray(value), _SHAPES.get(name, ())
            fits = numbers.dtype.kind in "if" and numbers.ndim == len(shape)
            fits = fits and all(b in (a, -1) for a, b in zip(numbers.shape, shape, strict=True))
            fits = fits and bool(np.isfinite(numbers).all())
        if not fits:
            raise ValueError(f"{name}={str(value)[:60]}")


def _open_network(file: Path, inputs: list[str], outputs: list[str]) -> Any:
    try:
        import onnxruntime
    except ImportError as error:
        raise PolicyError(f"onnxruntime is missing ({error}): pip install onnxruntime.") from error
    if not file.is_file():
        raise PolicyError(f"{file} is missing: it lies beside the settings when a policy is exported.")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # of so small a network, more threads only wait for each other
    try:
        session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises classes of its own, without a common base
        raise PolicyError(f"{file} is no network that onnxruntime takes ({error}).") from error
    there = [each.name for each in session.get_inputs()]
    if sorted(there) != sorted(inputs):
        raise PolicyError(f"{file} reads {there}, not {inputs}: it is of another policy.")
    said = [each.name for each in session.get_outputs()]
    if said != outputs:
        raise PolicyError(f"{file} says {said}, not {outputs}: it is of another policy.")
    return session


if __name__ == "__main__":
    try:
        policy = GraspPolicy(sys.argv[1] if len(sys.argv) > 1 else "policy.json")
    except PolicyError as error:
        sys.exit(f"error: {error}")
    made = ", ".join(each["name"] for each in policy.settings["transforms"])
    print(f"{policy.horizon} steps; reads {', '.join(policy.settings['inputs'])}; transforms: {made}")
