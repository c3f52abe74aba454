import pytest

from torchgrasp.objects import GraspObject, ProceduralObjects
from torchgrasp.objects.families import FAMILIES


@pytest.fixture(scope="session")
def cache_dir(tmp_path_factory):
    return tmp_path_factory.mktemp("objects")


@pytest.fixture(scope="session")
def one_of_each(cache_dir) -> dict[str, GraspObject]:
    objects = ProceduralObjects("test", num_objects=len(FAMILIES), cache_dir=cache_dir)
    return {item.family: item for item in objects}


@pytest.fixture(params=list(FAMILIES))
def item(request, one_of_each) -> GraspObject:
    return one_of_each[request.param]
