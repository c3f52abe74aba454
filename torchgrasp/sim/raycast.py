"""The ray-cast camera: depth and target mask without Vulkan or a display."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.camera import T_EE_CAMERA, Camera, CameraIntrinsics, View
from torchgrasp.sim.panda_tables import hand_boxes
from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER


class RaycastCamera(Camera):
    """Depth and target mask of the wrist camera, by Embree for the target, in closed form for the rest.

    The target, the table and the robot's own fingers and hand are seen and hide each other.

    Args:
        intrinsics: picture size, field of view and range.
        T_ee_camera: (4, 4) pose of the camera in the hand frame.
    """

    def __init__(
        self, intrinsics: CameraIntrinsics | None = None, *, T_ee_camera: np.ndarray = T_EE_CAMERA
    ) -> None:
        super().__init__(intrinsics, T_ee_camera=T_ee_camera)
        self._hand_depths: dict[tuple[float, ...], np.ndarray] = {}

    def observe(self, view: View) -> dict[str, np.ndarray]:
        """Depth and mask, see `Camera.observe`."""
        T_base_camera = self.pose(view.T_base_ee)
        depth = np.minimum(self._cast_table(T_base_camera), self._hand_depth(view.joints[7:]))
        seen = self._cast_target(view.target, np.linalg.solve(view.T_base_object, T_base_camera))
        mask = seen < depth
        depth = np.where(mask, seen, depth)
        depth[depth > self.intrinsics.far] = 0.0
        mask &= depth > 0.0
        shape = (self.intrinsics.height, self.intrinsics.width)
        return {"depth": depth.reshape(shape), "mask": mask.reshape(shape)}

    def _cast_target(self, target: GraspObject, T_object_camera: np.ndarray) -> np.ndarray:
        """(H*W,) depth of the target, inf where it is missed. Only the rays of its outline's box are cast."""
        depth = np.full(len(self.intrinsics.rays), np.inf, dtype=np.float32)
        window = self._window(target, T_object_camera)
        if not len(window):
            return depth
        near = np.float32(self.intrinsics.near)
        directions = self.intrinsics.rays[window] @ T_object_camera[:3, :3].T.astype(np.float32)
        origins = T_object_camera[:3, 3].astype(np.float32) + near * directions
        hit = embree_scene(target).scene.run(origins, directions, query="DISTANCE") + near
        depth[window] = np.where(hit < 1e3, hit, np.inf)
        return depth

    def _window(self, target: GraspObject, T_object_camera: np.ndarray) -> np.ndarray:
        """Indices of the pixels that the target's bounding box can cover."""
        cam = self.intrinsics
        lower, upper = embree_scene(target).bounds
        corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), axis=-1).reshape(-1, 3)
        seen = (corners - T_object_camera[:3, 3]) @ T_object_camera[:3, :3]
        if seen[:, 2].max() <= cam.near:
            return np.empty(0, dtype=np.int64)
        if seen[:, 2].min() <= cam.near:
            return np.arange(len(cam.rays))
        pixels = seen[:, :2] / seen[:, 2:] * cam.focal + (cam.width / 2, cam.height / 2)
        u0, v0 = np.clip(np.floor(pixels.min(axis=0)), 0, (cam.width, cam.height)).astype(int)
        u1, v1 = np.clip(np.ceil(pixels.max(axis=0)), 0, (cam.width, cam.height)).astype(int)
        return (np.arange(v0, v1)[:, None] * cam.width + np.arange(u0, u1)).reshape(-1)

    def _cast_table(self, T_base_camera: np.ndarray) -> np.ndarray:
        """(H*W,) depth of the table's top, inf where it is missed."""
        x, y, z = T_base_camera[:3, :3].astype(np.float32) @ self.intrinsics.rays.T
        origin = T_base_camera[:3, 3].astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = -origin[2] / z
            hit_x, hit_y = origin[0] + depth * x, origin[1] + depth * y
        seen = (depth > self.intrinsics.near) & (hit_x >= TABLE_LOWER[0]) & (hit_x <= TABLE_UPPER[0])
        seen &= (hit_y >= TABLE_LOWER[1]) & (hit_y <= TABLE_UPPER[1])
        depth[~seen] = np.inf
        return depth

    def _hand_depth(self, fingers: np.ndarray) -> np.ndarray:
        """(H*W,) depth of hand and fingers; kept for the openings met, to a tenth of a millimetre."""
        opening = tuple(np.round(fingers, 4).tolist())
        if opening not in self._hand_depths:
            if len(self._hand_depths) >= 64:
                self._hand_depths.clear()
            self._hand_depths[opening] = self._cast_hand(*opening)
        return self._hand_depths[opening]

    def _cast_hand(self, left: float, right: float) -> np.ndarray:
        """(H*W,) depth of hand and fingers, which stand still before the camera at one opening."""
        depth = np.full(len(self.intrinsics.rays), np.inf)
        for T_ee_box, size in hand_boxes(left, right):
            T_box_camera = np.linalg.solve(T_ee_box, self.T_ee_camera)
            rays = self.intrinsics.rays @ T_box_camera[:3, :3].T
            with np.errstate(divide="ignore", invalid="ignore"):
                sides = (np.array([[-1.0], [1.0]]) * size / 2)[:, None, :] - T_box_camera[:3, 3]
                times = sides / rays
            enter, leave = times.min(axis=0).max(axis=-1), times.max(axis=0).min(axis=-1)
            hit = (enter <= leave) & (leave > self.intrinsics.near)
            # A box that reaches behind the near plane is seen from inside, as a renderer shows it.
            seen = np.where(enter > self.intrinsics.near, enter, leave)
            depth = np.where(hit, np.minimum(depth, seen), depth)
        return depth.astype(np.float32)


@dataclass(frozen=True)
class _Surface:
    scene: EmbreeScene
    mesh: TriangleMesh
    bounds: tuple[np.ndarray, np.ndarray]


_surfaces: dict[str, _Surface] = {}
_MAX_SURFACES = 512


def embree_scene(target: GraspObject) -> _Surface:
    """The target's surface, ready for rays in the object frame; the last 512 are kept."""
    surface = _surfaces.pop(target.content_hash, None)
    if surface is None:
        scene = EmbreeScene()
        vertices = np.ascontiguousarray(target.vertices, dtype=np.float32)
        mesh = TriangleMesh(scene, vertices, np.ascontiguousarray(target.faces, dtype=np.int32))
        surface = _Surface(scene, mesh, (vertices.min(axis=0) - 1e-4, vertices.max(axis=0) + 1e-4))
    _surfaces[target.content_hash] = surface
    if len(_surfaces) > _MAX_SURFACES:
        _surfaces.pop(next(iter(_surfaces)))
    return surface
