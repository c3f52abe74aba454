"""Films of episodes: what is in a frame, what is written, what is refused."""

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from torchgrasp import keys
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.report.drawing import draw_cloud, enlarge, shade_depth
from torchgrasp.report.film import EndingRecorder, EpisodeFilm, write_video
from torchgrasp.sim import CameraIntrinsics, RaycastCamera, RenderCamera
from torchgrasp.transforms import AppendGripperPoints, DepthToPoints, SamplePoints

OBJECTS = ProceduralObjects("train", num_objects=1, num_grasps=100)


@pytest.fixture(scope="module")
def episode():
    """A successful episode of 30 steps in one world, and its ending."""
    torch.set_num_threads(1)
    base = GraspEnv(1, objects=OBJECTS, camera=RaycastCamera(CameraIntrinsics(32, 32)), seed=0)
    recorder = EndingRecorder(base)
    env = TransformedEnv(base, Compose(DepthToPoints(), SamplePoints(64), AppendGripperPoints()))
    steps = env.rollout(30, ExpertPolicy(OBJECTS, horizon=30))[0]
    assert steps["next", "reward"].sum() == 1
    return steps, recorder.endings[0]


def test_a_film_has_a_frame_for_each_state_and_the_ending(episode):
    steps, ending = episode
    frames = list(EpisodeFilm(OBJECTS, size=64, rendered=False).frames(steps[-3:], ending))
    assert len(frames) == 3 + 1 + len(ending) and len(ending) == 10  # closed, eight stages, at rest
    assert {frame.shape for frame in frames} == {(96, 3 * 64, 3)} and frames[0].dtype == np.uint8
    assert (frames[0] != frames[2]).any()
    # Outside, the target is elsewhere after lifting; what was sensed is what was sensed last.
    assert (frames[-1][32:, :64] != frames[-10][32:, :64]).any()
    assert np.array_equal(frames[-1][32:, 64:], frames[-10][32:, 64:])


def test_the_ending_is_the_lifted_object(episode):
    steps, ending = episode
    rise = ending[-1].T_base_object[2, 3] - steps["next", "T_base_object"][-1, 2, 3].item()
    assert rise > 0.08 and ending[-1].joints.shape == (9,)


def test_without_a_cloud_there_are_two_pictures(episode):
    steps = episode[0].exclude("points", ("next", "points"))
    frame = next(EpisodeFilm(OBJECTS, size=64, rendered=False).frames(steps))
    assert frame.shape == (96, 128, 3)


@pytest.mark.vulkan
@pytest.mark.pybullet
@pytest.mark.parametrize("engine", ["sapien", "mujoco"])
def test_a_rendered_film_shows_the_panda_and_changes_nothing_else(engine):
    camera = RenderCamera(CameraIntrinsics(32, 32), rgb=False)
    env = GraspEnv(1, objects=OBJECTS, camera=camera, horizon=4, seed=0, engine=engine)
    steps = env.rollout(2, ExpertPolicy(OBJECTS, horizon=4))[0]
    shapes = next(EpisodeFilm(OBJECTS, size=64, robot="shapes").frames(steps))
    meshes = next(EpisodeFilm(OBJECTS, size=64).frames(steps))
    assert (shapes[32:, :64] != meshes[32:, :64]).any(axis=-1).mean() > 0.02
    assert np.array_equal(shapes[:, 64:], meshes[:, 64:])
    env.start_episodes_at([0])  # what the environment observes is the same after a film as before
    again = env.rollout(2, ExpertPolicy(OBJECTS, horizon=4))[0]
    assert all((steps[key] == again[key]).all() for key in (keys.DEPTH, keys.MASK, keys.JOINTS, keys.ACTION))


def test_the_file_holds_the_frames_and_a_second_of_the_last(tmp_path):
    frames = [np.full((64, 128, 3), shade, dtype=np.uint8) for shade in (0, 120, 240)]
    path = write_video(tmp_path / "new" / "film.mp4", frames, fps=5)
    reader = imageio_ffmpeg.read_frames(str(path))
    assert next(reader)["size"] == (128, 64)
    shades = [np.frombuffer(frame, np.uint8).mean() for frame in reader]
    assert len(shades) == 3 + 5
    assert np.allclose(shades, [0, 120] + [240] * 6, atol=12)


def test_shading_is_bright_where_a_surface_faces_the_camera():
    lens = CameraIntrinsics(20, 20)
    depth = np.full((20, 20), 0.5, dtype=np.float32)
    mask = np.zeros((20, 20), dtype=bool)
    mask[:, 10:] = True
    flat = shade_depth(depth, mask, lens)
    assert flat[10, 5].min() > 150 and flat[10, 15, 0] > flat[10, 15, 2] + 100  # grey; orange
    steep = shade_depth(depth / (1 + lens.rays.reshape(20, 20, 3)[..., 0] * 0.9), mask, lens)
    assert steep[10, 5].mean() < flat[10, 5].mean()
    assert (shade_depth(0 * depth, mask, lens) == 245).all()


def test_a_point_is_drawn_where_the_camera_sees_it():
    # 90 degrees, 100 pixels: focal length 50. (0.2, -0.1, 1) falls on column 60, row 45.
    picture = draw_cloud(np.array([[0.2, -0.1, 1.0]]), np.eye(4), np.eye(4), CameraIntrinsics(100, 100))
    assert picture[45, 60, 0] > 200 > picture[45, 60, 2] and (picture[5, 5] == 245).all()


def test_enlarging_repeats_pixels():
    picture = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    assert np.array_equal(enlarge(picture, 4), picture.repeat(2, axis=0).repeat(2, axis=1))


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="multiple of 16"):
        EpisodeFilm(OBJECTS, size=100, rendered=False)
    with pytest.raises(ConfigError, match="robot='boxes'"):
        EpisodeFilm(OBJECTS, robot="boxes")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigError, match="no frame"):
        write_video(tmp_path / "film.mp4", [])
