import numpy as np
import pytest

from torchgrasp.objects.build import build_object
from torchgrasp.objects.families import FAMILIES
from torchgrasp.objects.model import GraspObject
from torchgrasp.objects.solids import Solid, box, cylinder
from torchgrasp.sim import Engine, make_engine


def build(solid: Solid, name: str) -> GraspObject:
    rng = np.random.default_rng(0)
    return build_object(solid, name=name, family=name, licence="MIT", num_grasps=20, rng=rng)


@pytest.fixture(scope="session")
def brick() -> GraspObject:
    """A box of 5 x 6 x 8 cm."""
    return build(box((0.05, 0.06, 0.08)), "brick")


@pytest.fixture(scope="session")
def can() -> GraspObject:
    """A cylinder about z, 3 cm in radius, 10 cm high."""
    return build(cylinder(0.03, 0.10), "can")


@pytest.fixture(scope="session")
def ball() -> GraspObject:
    """An ellipsoid, which rolls."""
    return build(FAMILIES["ellipsoid"](np.random.default_rng(1)), "ball")


@pytest.fixture(params=["sapien", "mujoco"])
def engine(request) -> Engine:
    """Each engine in turn."""
    return make_engine(request.param)
