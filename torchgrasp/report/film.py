"""Episodes as films: the scene from outside, the wrist's picture, the cloud that the policy sees."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.data.files import writing
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.objects.model import GraspObject
from torchgrasp.report.drawing import draw_cloud, enlarge, observed_points, shade_depth, write_caption
from torchgrasp.sim import CameraIntrinsics, RaycastCamera, RenderCamera, View, look_at, probe_renderer
from torchgrasp.sim.kinematics import forward_kinematics
from torchgrasp.sim.robot_look import RobotLookName, check_robot

# A control step lasts 0.15 s.
REAL_TIME = 1 / 0.15
# From where the scene is seen, and how near the target its cloud is drawn; metres, base frame.
_EYE, _AIM = (1.25, -0.8, 0.65), (0.42, 0.0, 0.2)
_NEAR_TARGET = np.array([0.26, -0.28, 0.22])


@dataclass(frozen=True)
class Moment:
    """A state between two observations: (9,) joints and the target's (4, 4) pose."""

    joints: np.ndarray
    T_base_object: np.ndarray


class EndingRecorder:
    """Keeps what a GraspEnv of this process does after an episode's last observation: closing, lifting.

    Args:
        env: the environment, without its transforms.
    """

    def __init__(self, env: GraspEnv) -> None:
        self._worlds = env.worlds
        self.endings: dict[int, list[Moment]] = {}
        env.worlds.watcher = self._record

    def _record(self, row: int) -> None:
        moment = Moment(self._worlds.joints[row], self._worlds.T_base_object[row])
        self.endings.setdefault(row, []).append(moment)


class EpisodeFilm:
    """Draws the frames of recorded episodes; no environment is needed.

    A frame shows, side by side, the scene from a place that stands still, the wrist camera's picture
    with the target in orange, and, where there are POINTS, the cloud that the policy sees with the hand
    in blue. The scene is rendered in colour where the machine can, with the Panda as it looks where its
    meshes are installed (extra `random-urdfs`); else it is drawn from rays, which meet its colliding shapes.

    Closing and lifting happen after the last observation: `ending` of EndingRecorder shows them.

    Args:
        objects: the set that OBJECT_ID counts in.
        size: of each of the pictures, pixels; a multiple of 16, as video formats want.
        rendered: whether the scene is in colour; None where the renderer works.
        intrinsics: of the wrist camera; looking at the middle of its picture, 90 degrees high, by default.
        robot: "shapes" renders what collides in place of the meshes.
    """

    def __init__(
        self,
        objects: Sequence[GraspObject],
        *,
        size: int = 336,
        rendered: bool | None = None,
        intrinsics: CameraIntrinsics | None = None,
        robot: RobotLookName = "meshes",
    ) -> None:
        check_range("size", size, 64, 2048)
        check_robot(robot)
        if size % 16:
            raise ConfigError(f"size={size} is no multiple of 16: give {size // 16 * 16 or 16}.")
        self._objects = objects
        self._size, self._intrinsics = size, intrinsics
        self._lens = CameraIntrinsics(size, size, fov=0.9, near=0.05, far=5.0)
        use = probe_renderer().ok if rendered is None else rendered
        make = partial(RenderCamera, robot=robot) if use else RaycastCamera
        self._outside = make(self._lens, T_base_camera=look_at(_EYE, _AIM))

    def frames(self, steps: TensorDictBase, ending: Sequence[Moment] = ()) -> Iterator[np.ndarray]:
        """(H, W, 3) uint8 frames of one episode's steps (T), of the state after them, and of its ending."""
        num_steps, target = len(steps), self._objects[int(steps[keys.OBJECT_ID][0])]
        centre = _array(steps, keys.T_BASE_OBJECT)[0, :3, 3]
        near = look_at((centre + _NEAR_TARGET).tolist(), centre.tolist())
        lifted = "lifted" if float(steps["next", "reward"].sum()) > 0 else "not lifted"
        senses = np.empty(0)
        for t in range(num_steps + 1):
            state: Any = steps[t] if t < num_steps else steps["next"][t - 1]
            words = [f"step {t} of {num_steps}", target.name]
            words += [lifted] if t == num_steps else []
            now = Moment(*(_array(state, key) for key in (keys.JOINTS, keys.T_BASE_OBJECT)))
            senses = self._senses(state, near)
            yield write_caption(np.hstack((self._scene(now, target), senses)), "   ".join(words))
        for now in ending:
            yield write_caption(np.hstack((self._scene(now, target), senses)), f"{target.name}   {lifted}")

    def _scene(self, now: Moment, target: GraspObject) -> np.ndarray:
        """What stands where, from outside."""
        T_base_ee = forward_kinematics(now.joints[None, :7])[0]
        scene = self._outside.observe(View(target, now.T_base_object, now.joints, T_base_ee))
        return scene["rgb"] if "rgb" in scene else shade_depth(scene["depth"], scene["mask"], self._lens)

    def _senses(self, state: TensorDictBase, T_base_near: np.ndarray) -> np.ndarray:
        """The wrist camera's picture and, where there is one, the cloud."""
        panels = [enlarge(self._wrist(state), self._size)]
        if state.get(keys.POINTS, None) is not None:
            points = observed_points(_array(state, keys.POINTS))
            panels.append(draw_cloud(points, _array(state, keys.T_BASE_EE), T_base_near, self._lens))
        return np.hstack(panels)

    def _wrist(self, state: TensorDictBase) -> np.ndarray:
        """The wrist camera's colours, or its depth shaded with the target in orange."""
        if (rgb := state.get(keys.RGB, None)) is not None:
            return rgb.cpu().numpy()
        depth, mask = state.get(keys.DEPTH).cpu().numpy(), state.get(keys.MASK).cpu().numpy()
        intrinsics = self._intrinsics or CameraIntrinsics(depth.shape[1], depth.shape[0])
        return shade_depth(depth, mask, intrinsics)


def _array(state: TensorDictBase, key: str) -> np.ndarray:
    return state.get(key).double().cpu().numpy()


def write_video(path: str | Path, frames: Iterable[np.ndarray], *, fps: float = REAL_TIME) -> Path:
    """Write frames (H, W, 3) uint8 of one size to an mp4 file; the last is held for a second.

    Raises:
        ConfigError: where the extra `viz` is not installed.
    """
    check_video_tools()
    path = Path(path)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_frames(path, frames, fps)
    return path


def _write_frames(path: Path, frames: Iterable[np.ndarray], fps: float) -> None:
    import imageio_ffmpeg

    writer, frame = None, None
    try:
        for frame in frames:
            if writer is None:
                size = (frame.shape[1], frame.shape[0])
                writer = imageio_ffmpeg.write_frames(
                    str(path),
                    size,
                    fps=fps,  # pyright: ignore[reportArgumentType] (ffmpeg takes fractions)
                    quality=8,
                )
                writer.send(None)
            writer.send(np.ascontiguousarray(frame))
        if writer is None or frame is None:
            raise ConfigError(f"{path}: there is no frame to write.")
        for _ in range(round(fps)):
            writer.send(np.ascontiguousarray(frame))
    finally:
        if writer is not None:
            writer.close()


def check_video_tools() -> None:
    """Raise ConfigError where what writes videos is not installed."""
    try:
        import imageio_ffmpeg  # noqa: F401
        import PIL  # noqa: F401
    except ImportError as error:
        raise ConfigError(f'Videos need the extra viz ({error}): pip install "torchgrasp[viz]".') from error
