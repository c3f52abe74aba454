"""The tabletop protocol's starts; those that face the target are proved with the scenes."""

import numpy as np
import pytest

from torchgrasp.envs import StaticTarget, TabletopStart
from torchgrasp.envs.scene import SceneSampler
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import Physics
from torchgrasp.sim import kinematics as kin

OBJECTS = ProceduralObjects("train", num_objects=4, num_grasps=100)


def scenes(**options) -> list:
    sampler = SceneSampler(OBJECTS, physics=Physics(), start=TabletopStart(**options), motion=StaticTarget())
    return [sampler.sample(0, 0, episode) for episode in range(15)]


def in_hand(scene) -> np.ndarray:
    T_base_ee = kin.forward_kinematics(scene.q[None])[0]
    return T_base_ee[:3, :3].T @ (scene.T_base_object[:3, 3] - T_base_ee[:3, 3])


def test_a_fixed_start_is_one_posture_from_which_objects_are_seen():
    drawn = scenes()
    assert len({tuple(scene.q) for scene in drawn}) == 1
    for scene in drawn:
        x, y, z = in_hand(scene)
        assert z > 0.1 and np.hypot(x, y) / z < np.tan(0.7)
    assert len({scene.object_id for scene in drawn}) > 1


def test_a_varied_start_spreads_about_it():
    q = np.stack([scene.q for scene in scenes(spread=0.2)])
    away = np.abs(q - np.asarray(TabletopStart().q))
    assert away.max() <= 0.2 and away.max(0).min() > 0.08


@pytest.mark.parametrize(("options", "word"), [({"q": (0.0,)}, "^q="), ({"spread": -1.0}, "^spread=")])
def test_impossible_starts_are_refused(options, word):
    with pytest.raises(ConfigError, match=word):
        TabletopStart(**options)
