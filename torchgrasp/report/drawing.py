"""Pictures for people: shaded depth, point clouds, captions. All are (H, W, 3) uint8."""

from __future__ import annotations

import numpy as np

from torchgrasp.geometry import gripper_control_points
from torchgrasp.sim import CameraIntrinsics

_TARGET = np.array([235, 150, 60], dtype=np.float32)
_REST = np.array([170, 175, 185], dtype=np.float32)
_HAND = np.array([60, 110, 200], dtype=np.uint8)
_BACKGROUND = np.uint8(245)
# Which of the control points X_g are joined by lines: base to base, base to tip twice, palm to the middle.
_HAND_LINES = ((2, 3), (2, 4), (3, 5))


def shade_depth(depth: np.ndarray, mask: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """Surfaces of a depth picture (H, W) as if lit from the camera, the target in orange.

    A surface is the darker the more it turns away; normals come from neighbouring pixels.
    """
    points = intrinsics.rays.reshape(*depth.shape, 3) * depth[..., None]
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(points, axis=-1)
    facing = np.abs((normal * points).sum(axis=-1)) / np.maximum(length, 1e-12)
    light = 0.25 + 0.75 * facing
    picture = np.where(mask[..., None], _TARGET, _REST) * light[..., None]
    picture[depth <= 0] = _BACKGROUND
    return picture.clip(0, 255).astype(np.uint8)


def draw_cloud(
    points: np.ndarray, T_base_ee: np.ndarray, T_base_camera: np.ndarray, intrinsics: CameraIntrinsics
) -> np.ndarray:
    """A cloud (N, 3) of the hand frame and the hand's control points, seen by a camera in the base."""
    picture = np.full((intrinsics.height, intrinsics.width, 3), _BACKGROUND)
    T_camera_ee = np.linalg.solve(T_base_camera, T_base_ee)
    seen = points @ T_camera_ee[:3, :3].T + T_camera_ee[:3, 3]
    seen = seen[np.argsort(-seen[:, 2])]  # the nearest last, on top
    if len(seen):
        low, high = seen[:, 2].min(), seen[:, 2].max()
        near = 1.0 - 0.6 * (seen[:, 2] - low) / max(high - low, 1e-6)
        _dots(picture, seen, intrinsics, (_TARGET * near[:, None]).astype(np.uint8), radius=2)
    ends = hand_lines() @ T_camera_ee[:3, :3].T + T_camera_ee[:3, 3]
    along = np.linspace(0.0, 1.0, 80)[:, None]
    lines = np.concatenate([start + along * (end - start) for start, end in ends])
    _dots(picture, lines, intrinsics, np.broadcast_to(_HAND, lines.shape), radius=3)
    return picture


def observed_points(cloud: np.ndarray) -> np.ndarray:
    """(M, 3) of a cloud's (N, C) rows without gripper points (flag 1) and rows filled in (zeros)."""
    seen = cloud[:, :3].any(axis=-1)
    if cloud.shape[-1] > 3:
        seen &= cloud[:, 3] == 0
    return cloud[seen, :3]


def hand_lines() -> np.ndarray:
    """(4, 2, 3) ends of the lines that stand for the gripper, metres in the ee frame, by X_g of Eq. (2)."""
    hand = gripper_control_points().numpy()
    ends = [(hand[a], hand[b]) for a, b in _HAND_LINES] + [(hand[0], (hand[2] + hand[3]) / 2)]
    return np.array(ends)


def _dots(
    picture: np.ndarray, seen: np.ndarray, intrinsics: CameraIntrinsics, colours: np.ndarray, radius: int = 1
) -> None:
    """Squares of colour at points (N, 3) of the camera frame, in their order."""
    front = seen[:, 2] > intrinsics.near
    seen, colours = seen[front], colours[front]
    pixels = np.floor(seen[:, :2] / seen[:, 2:] * intrinsics.focal + intrinsics.centre).astype(np.int64)
    for dv in range(-radius + 1, radius):
        for du in range(-radius + 1, radius):
            u, v = pixels[:, 0] + du, pixels[:, 1] + dv
            inside = (u >= 0) & (u < intrinsics.width) & (v >= 0) & (v < intrinsics.height)
            picture[v[inside], u[inside]] = colours[inside]


def enlarge(picture: np.ndarray, size: int) -> np.ndarray:
    """The picture (H, W, 3) at size x size, its pixels repeated."""
    rows = np.arange(size) * picture.shape[0] // size
    columns = np.arange(size) * picture.shape[1] // size
    return picture[rows[:, None], columns]


def write_caption(picture: np.ndarray, text: str, *, height: int = 32) -> np.ndarray:
    """The picture with a line of text above it."""
    from PIL import Image, ImageDraw, ImageFont

    bar = Image.new("RGB", (picture.shape[1], height), (30, 30, 34))
    ImageDraw.Draw(bar).text((10, 5), text, fill=(255, 255, 255), font=ImageFont.load_default(size=18))
    return np.concatenate((np.asarray(bar), picture))
