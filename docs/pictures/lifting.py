"""The moving picture of the first page: python docs/pictures/lifting.py [file].

The pretrained policy with six objects, in the first scene of a seed, whatever comes of it. Needs a renderer
(`python -m torchgrasp doctor`) and the extras ycb, random-urdfs (the Panda's meshes) and viz.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from contact_sheet import animate
from PIL import Image

import torchgrasp
from torchgrasp import keys
from torchgrasp.config import one_line_errors
from torchgrasp.objects import GraspObject, YcbObjects
from torchgrasp.report.drawing import enlarge, shade_depth
from torchgrasp.report.film import REAL_TIME, EndingRecorder, Moment
from torchgrasp.sim import CameraIntrinsics, RenderCamera, View, look_at
from torchgrasp.sim.kinematics import forward_kinematics

_NAMES = ("035_power_drill", "011_banana", "048_hammer", "051_large_clamp", "065-g_cups", "056_tennis_ball")
_COLUMNS, _SIZE, _INSET = 3, 240, 72
_HOLD = 10  # frames for which the last is shown
_OUTSIDE = RenderCamera(
    CameraIntrinsics(_SIZE, _SIZE, fov=0.72, near=0.05, far=5.0),
    T_base_camera=look_at((1.35, -0.75, 0.75), (0.38, 0.0, 0.24)),
    robot="meshes",
)


def film(target: GraspObject, policy: Any, seed: int) -> list[np.ndarray]:
    """(H, W, 3) frames of an episode: the scene, and in a corner what the wrist's camera sees."""
    env = torchgrasp.make_env(policy, objects=[target], num_envs=1, seed=seed)
    recorder, wrist = EndingRecorder(env.base_env), env.base_env.cameras["camera"].intrinsics
    steps = env.rollout(env.horizon, policy)[0]
    print(f"{target.name}: {'lifted' if steps['next', 'reward'].sum() > 0 else 'not lifted'}")
    frames = []
    for state in steps:
        now = Moment(*(state[key].double().numpy() for key in (keys.JOINTS, keys.T_BASE_OBJECT)))
        seen = shade_depth(state[keys.DEPTH].numpy(), state[keys.MASK].numpy(), wrist)
        frames.append(_draw(target, now, seen))
    return frames + [_draw(target, now, seen) for now in recorder.endings[0]]


def _draw(target: GraspObject, now: Moment, seen: np.ndarray) -> np.ndarray:
    T_base_ee = forward_kinematics(now.joints[None, :7])[0]
    picture = _OUTSIDE.observe(View(target, now.T_base_object, now.joints, T_base_ee))["rgb"].copy()
    picture[:_INSET, -_INSET:] = enlarge(seen, _INSET)
    return picture


def _tile(films: list[list[np.ndarray]]) -> list[Image.Image]:
    """Films side by side, each waiting for the longest at its end."""
    tiled = []
    for t in range(max(map(len, films))):
        panels = [each[min(t, len(each) - 1)] for each in films]
        rows = [np.hstack(panels[i : i + _COLUMNS]) for i in range(0, len(panels), _COLUMNS)]
        tiled.append(Image.fromarray(np.vstack(rows)))
    return tiled


@one_line_errors()
def main(path: Path) -> None:
    """Write the picture."""
    policy, found = torchgrasp.load_policy("pretrained"), {each.name: each for each in YcbObjects("others")}
    frames = _tile([film(found[name], policy, seed) for seed, name in enumerate(_NAMES)])
    milliseconds = [round(1e3 / REAL_TIME)] * (len(frames) - 1) + [round(1e3 * _HOLD / REAL_TIME)]
    animate(path, frames, milliseconds)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("lifting.webp"))
