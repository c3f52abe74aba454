import pytest
import settings


def test_videos_of_the_first_episodes_are_written(run_recipe, tmp_path):
    options = ["episodes=3", "evaluation.num_envs=2", "env.horizon=3", "collector.num_workers=0"]
    options += ["objects.num_objects=1", "objects.num_grasps=100", "video=true", "video.episodes=2"]
    code, _, err = run_recipe("evaluate", "policy=random", *options)
    assert code == 0, err
    videos = sorted(path.name for path in tmp_path.glob("evaluate/*/videos/*.mp4"))
    assert len(videos) == 2 and videos[0].startswith("000_") and videos[1].startswith("001_")


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["video=true"], ["video.episodes=3"]),
        (["video=True", "seed=1"], ["video.episodes=3", "seed=1"]),
        (["video=false"], ["video.episodes=0"]),
        (["video=true", "video.episodes=9"], ["video.episodes=9"]),
        (["video.episodes=9", "video=true"], ["video.episodes=9"]),
        (["episodes=5"], ["episodes=5"]),
    ],
)
def test_a_switch_for_videos_is_a_number_of_episodes(given, meant):
    assert settings.expand_video(given) == meant
