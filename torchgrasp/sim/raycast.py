"""The ray-cast camera: depth and target mask without Vulkan or a display."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.spatial import ConvexHull, QhullError

from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.camera import T_EE_CAMERA, Camera, CameraIntrinsics, View
from torchgrasp.sim.panda_pose import ARM_SIZES, HAND_SIZES, arm_poses, half_extents, hand_poses
from torchgrasp.sim.rays import corners, first_surface, picture_window
from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER

_SIZES = (*ARM_SIZES, *HAND_SIZES)
_HALVES = np.stack([half_extents(size) for size in _SIZES])
_RADII = np.linalg.norm(_HALVES, axis=-1)


class RaycastCamera(Camera):
    """Depth and target mask by Embree for the target, in closed form for the rest.

    The target, the table's top and the robot are seen and hide each other.

    Args:
        intrinsics: picture size, field of view and range.
        T_ee_camera: (4, 4) pose of the camera in the hand frame.
        T_base_camera: (4, 4) pose of a static camera in the base frame, which takes the place of the
            former.
    """

    def __init__(
        self,
        intrinsics: CameraIntrinsics | None = None,
        *,
        T_ee_camera: np.ndarray = T_EE_CAMERA,
        T_base_camera: np.ndarray | None = None,
    ) -> None:
        super().__init__(intrinsics, T_ee_camera=T_ee_camera, T_base_camera=T_base_camera)
        cam = self.intrinsics
        self._rays = cam.rays.reshape(cam.height, cam.width, 3)
        self._hand_depths: dict[tuple[float, ...], np.ndarray] = {}
        # (4, 3) the picture's side planes: a ball that lies beyond one of them is out of sight.
        (left, top), (right, bottom) = cam.centre / cam.focal, (cam.size - cam.centre) / cam.focal
        planes = np.array([(1.0, 0.0, -right), (-1.0, 0.0, -left), (0.0, 1.0, -bottom), (0.0, -1.0, -top)])
        self._sides = planes / np.linalg.norm(planes, axis=-1, keepdims=True)
        ends = np.array([0, -1])
        self._corner_rays = self._rays[np.ix_(ends, ends)].reshape(4, 3).T.astype(np.float64)

    def observe(self, view: View) -> dict[str, np.ndarray]:
        """Depth and mask, see `Camera.observe`."""
        T_base_camera = self.pose(view.T_base_ee)
        depth = self._cast_table(T_base_camera)
        shapes = arm_poses(view.joints[:7])
        if self.T_base_camera is None:
            np.minimum(depth, self._hand_depth(view.joints[7:]), out=depth)
        else:
            shapes = np.concatenate((shapes, hand_poses(view.T_base_ee, view.joints[7:])))
        self._paint_robot(depth, _inverse(T_base_camera) @ shapes)
        mask = self._paint_target(depth, view.target, _inverse(view.T_base_object) @ T_base_camera)
        out_of_range = depth > self.intrinsics.far
        depth[out_of_range] = 0.0
        mask[out_of_range] = False
        return {"depth": depth, "mask": mask}

    def _paint_target(
        self, depth: np.ndarray, target: GraspObject, T_object_camera: np.ndarray
    ) -> np.ndarray:
        """Put the target into a depth picture (H, W); (H, W) bool where it is seen."""
        mask = np.zeros(depth.shape, dtype=bool)
        surface = embree_scene(target)
        window = self._window(surface, T_object_camera)
        if window is None:
            return mask
        behind, rays = depth[window], self._rays[window].reshape(-1, 3)
        # Rays have a depth of 1, so that the camera's place can ride along in the third column.
        turn = T_object_camera[:3, :3].T.astype(np.float32)
        near = np.float32(self.intrinsics.near) * turn
        near[2] += T_object_camera[:3, 3]
        hit = surface.scene.run(rays @ near, rays @ turn, query="DISTANCE").reshape(behind.shape)
        hit += np.float32(self.intrinsics.near)
        # Where a ray meets nothing embree answers 1e37, which `observe` finds out of range.
        np.less(hit, behind, out=mask[window])
        np.minimum(behind, hit, out=behind)
        return mask

    def _window(self, surface: _Surface, T_object_camera: np.ndarray) -> tuple[slice, slice] | None:
        """Rows and columns that the target's outline can cover."""
        T_camera_object = _inverse(T_object_camera)
        for points in (surface.hull, surface.corners):
            seen = points @ T_camera_object[:3, :3].T + T_camera_object[:3, 3]
            # Where the near plane cuts the target, a box's few corners are cut sooner than a hull's many.
            if points is surface.corners or seen[:, 2].min() > self.intrinsics.near:
                break
        return picture_window(seen, self.intrinsics)

    def _cast_table(self, T_base_camera: np.ndarray) -> np.ndarray:
        """(H, W) depth of the table's top, inf where it is missed."""
        cam, height = self.intrinsics, float(T_base_camera[2, 3])
        limits = _table_limits(T_base_camera, cam.near)
        met = limits @ self._corner_rays > 0
        if not met.any(axis=-1).all():
            return np.full((cam.height, cam.width), np.inf, dtype=np.float32)
        # What is linear in a ray is positive in the whole picture where it is so in the four corners.
        gradients = np.concatenate((T_base_camera[2:3, :3], limits[~met.all(axis=-1)])).astype(np.float32)
        columns = gradients[:, :1] * self._rays[0, :, 0]
        rows = (gradients[:, 1:2] * self._rays[:, 0, 1] + gradients[:, 2:])[:, :, None]
        with np.errstate(divide="ignore"):
            depth = np.float32(-height) / (columns[0] + rows[0])
        for column, row in zip(columns[1:], rows[1:], strict=True):
            np.copyto(depth, np.inf, where=column + row <= 0)
        return depth

    def _paint_robot(self, depth: np.ndarray, T_camera_shape: np.ndarray) -> None:
        """Put the robot's shapes that are in sight into a depth picture (H, W)."""
        cam, centres, radii = self.intrinsics, T_camera_shape[:, :3, 3], _RADII[: len(T_camera_shape)]
        hidden = (centres @ self._sides.T).max(axis=-1) > radii
        hidden |= np.abs(centres[:, 2] - (cam.near + cam.far) / 2) > radii + (cam.far - cam.near) / 2
        for i in np.flatnonzero(~hidden):
            self._paint_shape(depth, _SIZES[i], _HALVES[i], T_camera_shape[i])

    def _paint_shape(
        self, depth: np.ndarray, size: tuple[float, ...], half: np.ndarray, T_camera_shape: np.ndarray
    ) -> None:
        cam, turn = self.intrinsics, T_camera_shape[:3, :3]
        window = picture_window(corners(half) @ turn.T + T_camera_shape[:3, 3], cam)
        if window is None:
            return
        rays = turn.T.astype(np.float32) @ self._rays[window].reshape(-1, 3).T
        seen = first_surface(-T_camera_shape[:3, 3] @ turn, rays, size, cam.near)
        np.minimum(depth[window], seen.reshape(depth[window].shape), out=depth[window])

    def _hand_depth(self, fingers: np.ndarray) -> np.ndarray:
        """(H, W) depth of hand and fingers before the wrist camera, which move with it.

        Kept for the openings met, to a tenth of a millimetre.
        """
        opening = tuple(np.round(fingers, 4).tolist())
        if opening not in self._hand_depths:
            if len(self._hand_depths) >= 64:
                self._hand_depths.clear()
            depth = np.full(self._rays.shape[:2], np.inf, dtype=np.float32)
            poses = _inverse(self.T_ee_camera) @ hand_poses(np.eye(4), np.array(opening))
            for size, half, pose in zip(HAND_SIZES, _HALVES[len(ARM_SIZES) :], poses, strict=True):
                self._paint_shape(depth, size, half, pose)
            self._hand_depths[opening] = depth
        return self._hand_depths[opening]


def _table_limits(T_base_camera: np.ndarray, near: float) -> np.ndarray:
    """(6, 3) vectors whose dot products with a ray are all positive where it meets the table's top.

    The ray r from c meets z = 0 at the depth -c_z / r_z, which is to be positive, then beyond `near`;
    the place is to lie within the top's four edges. Both sides are multiplied by |r_z|.
    """
    turn, place = T_base_camera[:3, :3], T_base_camera[:3, 3]
    side, height = np.sign(place[2]), abs(place[2])
    limits = np.empty((6, 3))
    limits[0] = down = -side * turn[2]
    limits[1] = -near * down
    limits[1, 2] += height
    limits[2:4] = height * turn[:2] + (place[:2] - TABLE_LOWER[:2])[:, None] * down
    limits[4:] = -height * turn[:2] - (place[:2] - TABLE_UPPER[:2])[:, None] * down
    return limits


def _inverse(pose: np.ndarray) -> np.ndarray:
    """The inverse of a (4, 4) pose."""
    out = np.eye(4)
    out[:3, :3] = pose[:3, :3].T
    out[:3, 3] = -pose[:3, 3] @ pose[:3, :3]
    return out


@dataclass(frozen=True)
class _Surface:
    """A target ready for rays.

    Attributes:
        scene, mesh: Embree's.
        hull: (K, 3) the vertices of the convex hull.
        corners: (8, 3) of the bounding box.
    """

    scene: EmbreeScene
    mesh: TriangleMesh
    hull: np.ndarray
    corners: np.ndarray


_surfaces: dict[str, _Surface] = {}
_MAX_SURFACES = 512


def embree_scene(target: GraspObject) -> _Surface:
    """The target's surface, ready for rays in the object frame; the last 512 are kept."""
    surface = _surfaces.pop(target.content_hash, None)
    if surface is None:
        scene = EmbreeScene()
        vertices = np.ascontiguousarray(target.vertices, dtype=np.float32)
        mesh = TriangleMesh(scene, vertices, np.ascontiguousarray(target.faces, dtype=np.int32))
        surface = _Surface(scene, mesh, *_outline(vertices.astype(np.float64)))
    _surfaces[target.content_hash] = surface
    if len(_surfaces) > _MAX_SURFACES:
        _surfaces.pop(next(iter(_surfaces)))
    return surface


def _outline(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The hull's vertices and the bounding box's corners of (V, 3) vertices."""
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    box = (lower + upper) / 2 + corners((upper - lower) / 2 + 1e-4)
    try:
        return vertices[ConvexHull(vertices).vertices], box
    except QhullError:  # flat
        return box, box
