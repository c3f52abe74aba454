"""Rays against boxes and capsules in closed form, and the part of a picture that a shape can cover."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from torchgrasp.intrinsics import CameraIntrinsics

Window = tuple[slice, slice]
_CORNERS = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def corners(half: NDArray) -> NDArray:
    """(8, 3) corners of a box about the origin, from its (3,) half extents in metres."""
    return _CORNERS * half


def picture_window(points: NDArray, cam: CameraIntrinsics) -> Window | None:
    """Rows and columns of a picture that hold the hull of `points` beyond the near plane; None for none.

    Args:
        points: (K, 3) metres, camera frame.
        cam: the camera.
    """
    z = points[:, 2]
    near = max(cam.near, 1e-9)
    if z.min() <= near:
        ahead = z > near
        if not ahead.any():
            return None
        points = np.concatenate((points[ahead], _cut(points[ahead], points[~ahead], near)))
    pixels = points[:, :2] / points[:, 2:] * cam.focal + cam.centre
    (u0, v0), (u1, v1) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
    columns, rows = _covered(u0, u1, cam.width), _covered(v0, v1, cam.height)
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None


def _covered(low: float, high: float, count: int) -> slice:
    """Of `count` pixels those between low and high, a thousandth more for the rays' rounding."""
    return slice(math.floor(max(low - 1e-3, 0.0)), math.ceil(min(high + 1e-3, count)))


def _cut(ahead: NDArray, behind: NDArray, near: float) -> NDArray:
    """(A * B, 3) points at which the lines between points (A, 3) and (B, 3) cross z = near."""
    steps = ahead[:, None] - behind[None]
    share = (near - behind[None, :, 2]) / steps[..., 2]
    crossing = (behind + share[..., None] * steps).reshape(-1, 3)
    crossing[:, 2] = near
    return crossing


def first_surface(origin: NDArray, rays: NDArray, size: tuple[float, ...], near: float) -> NDArray:
    """Depths (N,) beyond `near` at which rays meet a shape's surface, inf where they miss it.

    A shape that reaches before the near plane is seen from inside, as a renderer shows it.

    Args:
        origin: (3,) the camera in the shape's frame, metres.
        rays: (3, N) float32 directions in the shape's frame, of depth 1.
        size: of the shape, as in `panda_tables.Shape`: a box's three sides or a capsule's radius and
            length along z.
        near: metres.
    """
    enter, leave = _box(origin, rays, size) if len(size) == 3 else _capsule(origin, rays, *size)
    seen = np.where(enter > near, enter, leave)
    seen[~((enter <= leave) & (leave > near))] = np.inf
    return seen


def _box(origin: NDArray, rays: NDArray, size: tuple[float, ...]) -> tuple[NDArray, NDArray]:
    """Depths (N,) at which rays enter and leave a box; enter > leave where they miss it."""
    slabs = [
        _slab(place, along, side / 2) for place, along, side in zip(origin.tolist(), rays, size, strict=True)
    ]
    (a, b, c), (d, e, f) = zip(*slabs, strict=True)
    return np.maximum(np.maximum(a, b), c), np.minimum(np.minimum(d, e), f)


def _slab(place: float, along: NDArray, reach: float) -> tuple[NDArray, NDArray]:
    """Depths (N,) at which rays enter and leave the space between -reach and reach of one axis."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-reach - place) / along, (reach - place) / along
    return np.minimum(one, other), np.maximum(one, other)


def _capsule(origin: NDArray, rays: NDArray, radius: float, length: float) -> tuple[NDArray, NDArray]:
    """Depths (N,) at which rays enter and leave a capsule: the union of a cylinder and two balls."""
    across, along = rays[0] ** 2 + rays[1] ** 2, rays[2]
    x, y, height = origin.tolist()
    turned, past = x * rays[0] + y * rays[1], x * x + y * y
    enter, leave = _quadratic(across, turned, past, radius)
    first, last = _slab(height, along, length / 2)
    enter, leave = np.maximum(enter, first), np.minimum(leave, last)
    missed = ~(enter <= leave)
    enter[missed], leave[missed] = np.inf, -np.inf
    for end in (-length / 2, length / 2):
        z = height - end
        ball = _quadratic(across + along**2, turned + z * along, past + z * z, radius)
        enter, leave = np.fmin(enter, ball[0]), np.fmax(leave, ball[1])
    return enter, leave


def _quadratic(a: NDArray, b: NDArray, c: float, radius: float) -> tuple[NDArray, NDArray]:
    """Both solutions t (N,) of a t^2 + 2 b t + c = radius^2, NaN where there are none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - a * (c - radius**2))
        return (-b - root) / a, (root - b) / a
