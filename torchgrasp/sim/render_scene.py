"""The scenes of a process in which things are rendered, one for each look of the robot."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from torchgrasp.errors import RenderError
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim._sapien import sapien
from torchgrasp.sim.appearance import Appearance
from torchgrasp.sim.camera import CameraIntrinsics
from torchgrasp.sim.probe import REMEDY
from torchgrasp.sim.robot_look import RobotLook
from torchgrasp.sim.scene_parts import FLOOR, Part, furniture
from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER
from torchgrasp.sim.visuals import Visual, mesh_visual, rectangle_visual

_MAX_TARGETS = 32
_MAX_TEXTURES = 48
# Depth to which things are drawn, metres: beyond a camera's range they are seen in colour only.
_DRAWN = 40.0
# Pixels of the shadow map, of which each costs time, and metres around the table that it covers.
_SHADOW_MAP, _SHADOW_REACH = 512, 1.0


class RenderScene:
    """Everything that can be seen, moved and dressed anew for each picture; there is no physics in it.

    Targets come and go: the last 32 stay in memory, one is shown.

    Args:
        look: of the robot.
    """

    def __init__(self, look: RobotLook) -> None:
        try:
            self._system = sapien.render.RenderSystem()
        except RuntimeError as error:
            raise RenderError(f"SAPIEN's renderer does not start ({error}): {REMEDY}") from None
        self._scene = sapien.Scene([self._system])
        self._cameras: dict[tuple[CameraIntrinsics, str], sapien.render.RenderCameraComponent] = {}
        self._targets: dict[str, sapien.Entity] = {}
        self._textures: dict[bytes, sapien.render.RenderTexture2D] = {}
        self._shown: sapien.Entity | None = None
        self._look: Appearance | None = None
        self._materials = {name: _matt() for name in ("target", "table", "floor")}
        self._robot_materials: list[tuple[sapien.render.RenderMaterial, NDArray]] = []
        self._robot = [self._add_robot_part(part) for part in look.parts]
        self._table = self._add(
            rectangle_visual(TABLE_LOWER, TABLE_UPPER, repeats=1.0), self._materials["table"]
        )
        self._seen = {entity.per_scene_id for entity in (*self._robot, self._table)}
        self._add_surroundings()
        self._sun = self._add_light(shadow=True)
        self._fill = self._add_light(shadow=False)

    def arrange(
        self, target: GraspObject, T_base_object: NDArray, robot: NDArray, appearance: Appearance
    ) -> None:
        """Show one state of a world.

        Args:
            target: the object that is shown, alone of all.
            T_base_object: (4, 4) its pose.
            robot: (P, 4, 4) poses of the parts of the robot's look, base frame.
            appearance: textures and light.
        """
        for entity, pose in zip(self._robot, robot.astype(np.float32), strict=True):
            entity.set_pose(sapien.Pose(pose))
        self._show(target)
        assert self._shown is not None
        self._shown.set_pose(sapien.Pose(T_base_object.astype(np.float32)))
        if appearance is not self._look:
            self._dress(appearance)
            self._look = appearance

    def picture(self, cam: CameraIntrinsics, T_base_camera: NDArray, *, colour: bool) -> dict[str, NDArray]:
        """Depth, mask and, where `colour`, RGB of what was arranged; shapes as `Camera.observe`'s."""
        camera = self._camera(cam, "default" if colour else "trivial")
        camera.entity.set_pose(sapien.Pose((T_base_camera @ _SAPIEN_AXES).astype(np.float32)))
        self._system.step()  # brings every pose, the camera's too, to the renderer
        camera.take_picture()
        depth = -camera.get_picture("Position")[..., 2]
        identity = camera.get_picture("Segmentation")[..., 1]
        assert self._shown is not None
        mask = identity == self._shown.per_scene_id
        seen = mask | np.isin(identity, list(self._seen))
        seen &= depth <= cam.far
        out = {"depth": np.where(seen, depth, np.float32(0.0)), "mask": mask & seen}
        if colour:
            rgb = np.clip(camera.get_picture("Color")[..., :3], 0.0, 1.0)
            out["rgb"] = (rgb * 255 + 0.5).astype(np.uint8)
        return out

    def _camera(self, cam: CameraIntrinsics, shader: str) -> sapien.render.RenderCameraComponent:
        if (cam, shader) not in self._cameras:
            # "default" lights and shades; "trivial" gives positions and identities only.
            shaders = Path(sapien.__file__).parent / "vulkan_shader"
            camera = sapien.render.RenderCameraComponent(cam.width, cam.height, str(shaders / shader))
            (fx, fy), (cx, cy) = cam.focal.tolist(), cam.centre.tolist()
            camera.set_perspective_parameters(
                max(cam.near, 1e-3),
                max(_DRAWN, cam.far),
                fx,
                fy,
                cx,
                cy,
                0,
            )
            entity = sapien.Entity()
            entity.add_component(camera)
            self._scene.add_entity(entity)
            self._cameras[cam, shader] = camera
        return self._cameras[cam, shader]

    def _show(self, target: GraspObject) -> None:
        """Let `target` be the one object that stands in the scene."""
        entity = self._targets.pop(target.content_hash, None)
        if entity is None:
            visual = mesh_visual(target.vertices, target.faces, repeats=6.0)
            entity = _entity(visual, self._materials["target"])
        self._targets[target.content_hash] = entity
        if len(self._targets) > _MAX_TARGETS:
            self._targets.pop(next(iter(self._targets)))
        if entity is not self._shown:
            if self._shown is not None:
                self._scene.remove_entity(self._shown)
            self._scene.add_entity(entity)
            self._shown = entity

    def _dress(self, appearance: Appearance) -> None:
        for name, material in self._materials.items():
            material.set_base_color_texture(self._texture(getattr(appearance, name)))
        for material, colour in self._robot_materials:
            material.set_base_color([*(colour * appearance.robot), 1.0])
        away = appearance.light_from / np.linalg.norm(appearance.light_from)
        self._sun.entity.set_pose(_looking_along(-away, np.array((0.6, 0.0, 0.0)) + 3.0 * away))
        self._sun.color = appearance.light.tolist()
        # A weaker light from the other side keeps the sun's shadow side from being flat.
        other = away * (-1.0, -1.0, 1.0)
        self._fill.entity.set_pose(_looking_along(-other, 3.0 * other))
        self._fill.color = (0.25 * appearance.light).tolist()
        self._system.ambient_light = appearance.ambient.tolist()

    def _texture(self, pixels: NDArray[np.uint8]) -> sapien.render.RenderTexture2D:
        """A texture of (S, S, 4) pixels; the last 48 are kept."""
        key = pixels.tobytes()
        texture = self._textures.pop(key, None)
        if texture is None:
            texture = sapien.render.RenderTexture2D(pixels, "R8G8B8A8Unorm", 1, "linear", "mirror", srgb=True)
        self._textures[key] = texture
        if len(self._textures) > _MAX_TEXTURES:
            self._textures.pop(next(iter(self._textures)))
        return texture

    def _add(self, visual: Visual, material: sapien.render.RenderMaterial) -> sapien.Entity:
        entity = _entity(visual, material)
        self._scene.add_entity(entity)
        return entity

    def _add_robot_part(self, part: Part) -> sapien.Entity:
        material = _material(part)
        self._robot_materials.append((material, np.array(part.colour)))
        return self._add(part.visual, material)

    def _add_surroundings(self) -> None:
        """Floor and furniture: seen in colour, never in depth."""
        floor = rectangle_visual(np.array((-25.0, -25.0)), np.array((25.0, 25.0)), repeats=0.5)
        self._add(floor, self._materials["floor"]).set_pose(sapien.Pose([0.0, 0.0, FLOOR]))
        for part in furniture():
            self._add(part.visual, _material(part)).set_pose(sapien.Pose(list(part.position)))

    def _add_light(self, *, shadow: bool) -> sapien.render.RenderDirectionalLightComponent:
        light = sapien.render.RenderDirectionalLightComponent()
        light.shadow = shadow
        if shadow:
            light.shadow_map_size = _SHADOW_MAP
            light.shadow_half_size = _SHADOW_REACH
            light.shadow_near, light.shadow_far = 1.0, 6.0
        entity = sapien.Entity()
        entity.add_component(light)
        self._scene.add_entity(entity)
        return light


# OpenCV's camera axes (z forward, x right, y down) as SAPIEN's (x forward, y left, z up).
_SAPIEN_AXES = np.array([[0, -1.0, 0, 0], [0, 0, -1.0, 0], [1.0, 0, 0, 0], [0, 0, 0, 1.0]])

_scenes: dict[str, RenderScene] = {}
_process: int | None = None


def render_scene(look: RobotLook) -> RenderScene:
    """The scene of this process in which the robot looks so, built at the first call."""
    global _process
    if _scenes and _process != os.getpid():
        raise RenderError(
            "A process that has rendered was forked, and its renderer does not survive that: start the "
            "workers by 'spawn' (ParallelEnv(..., mp_start_method='spawn')), or render in them alone."
        )
    if look.name not in _scenes:
        _scenes[look.name] = RenderScene(look)
        _process = os.getpid()
    return _scenes[look.name]


def _matt(*, roughness: float = 0.9, specular: float = 0.1) -> sapien.render.RenderMaterial:
    return sapien.render.RenderMaterial(roughness=roughness, specular=specular)


def _material(part: Part) -> sapien.render.RenderMaterial:
    material = _matt(roughness=part.roughness, specular=part.specular)
    material.set_base_color([*part.colour, 1.0])
    return material


def _entity(visual: Visual, material: sapien.render.RenderMaterial) -> sapien.Entity:
    """An entity that shows a mesh, made from arrays: SAPIEN caches what it reads from files."""
    body = sapien.render.RenderBodyComponent()
    body.attach(
        sapien.render.RenderShapeTriangleMesh(
            visual.vertices, visual.faces, visual.normals, visual.uvs, material
        )
    )
    entity = sapien.Entity()
    entity.add_component(body)
    return entity


def _looking_along(direction: NDArray, place: NDArray) -> sapien.Pose:
    """A pose whose x axis is the (3,) unit `direction`."""
    side = np.cross((0.0, 0.0, 1.0) if abs(direction[2]) < 0.9 else (0.0, 1.0, 0.0), direction)
    side /= np.linalg.norm(side)
    frame = np.eye(4)
    frame[:3, :3] = np.stack((direction, side, np.cross(direction, side)), axis=-1)
    frame[:3, 3] = place
    return sapien.Pose(frame)
