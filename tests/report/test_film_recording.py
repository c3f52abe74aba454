"""Films of a policy's episodes, as files."""

import pytest
from torchrl.envs import Compose, PendulumEnv, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import RandomAction
from torchgrasp.report.film_recording import record_films
from torchgrasp.rollouts import SerialPool
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import DepthToPoints, SamplePoints

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")


def test_a_file_for_each_episode_that_tells_object_and_outcome(tmp_path):
    objects = ProceduralObjects("train", num_objects=2, num_grasps=100)
    camera = RaycastCamera(CameraIntrinsics(12, 12))
    base = GraspEnv(2, objects=objects, camera=camera, horizon=2, first_world=5, seed=0)
    env = TransformedEnv(base, Compose(DepthToPoints(), SamplePoints(16)))
    paths = record_films(env, RandomAction(), tmp_path / "films", num_episodes=3, fps=4)
    with SerialPool({"test": lambda: env}) as pool:
        episodes = [each for batch in pool.run("test", RandomAction(), range(2)) for each in batch]
    told = [(each.object_name, "lifted" if each.success else "failed") for each in episodes[:3]]
    assert sorted((tmp_path / "films").iterdir()) == paths
    assert [path.name for path in paths] == [
        f"{number:03d}_{name.replace('/', '_')}_{word}.mp4" for number, (name, word) in enumerate(told)
    ]
    # Three states and ten pictures of closing and lifting, and the last for a second more.
    assert imageio_ffmpeg.count_frames_and_secs(str(paths[0]))[0] == 3 + 10 + 4


@pytest.mark.parametrize("env", [PendulumEnv(), TransformedEnv(PendulumEnv(), Compose())])
def test_another_environment_is_refused(env, tmp_path):
    with pytest.raises(ConfigError, match="env is a PendulumEnv: give a TransformedEnv around a GraspEnv"):
        record_films(env, RandomAction(), tmp_path, num_episodes=1, fps=4)
