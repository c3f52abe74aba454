"""Which files below a folder are meshes, and what their objects are called."""

import os

import pytest

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects import FolderObjects
from torchgrasp.objects.folder_listing import find_meshes, names_in_full


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_hidden_files_are_passed_over(tmp_path):
    touch(tmp_path, "box.obj", "._box.obj", ".trash/old.stl", "sub/MUG.STL", "sub/._MUG.STL", "note.txt")
    assert list(find_meshes(tmp_path)) == ["box", "sub/MUG"]


def test_links_to_folders_are_followed_and_loops_end(tmp_path):
    here, far = tmp_path / "here", tmp_path / "far"
    touch(here, "mug.obj", "z/cup.obj")
    touch(far, "box.obj", "inner/ball.obj")
    (here / "set").symlink_to(far)
    (here / "again").symlink_to(here)
    (far / "back").symlink_to(here)
    (here / "a").symlink_to(here / "z")  # lies here as well: under its own path
    assert list(find_meshes(here)) == ["mug", "set/box", "set/inner/ball", "z/cup"]


def test_links_that_lead_nowhere_and_folders_called_like_meshes(tmp_path):
    touch(tmp_path, "box.obj", "bottle.obj/mesh.obj")
    (tmp_path / "gone.obj").symlink_to(tmp_path / "nowhere.obj")
    (tmp_path / "round.obj").symlink_to(tmp_path / "round.obj")
    assert list(find_meshes(tmp_path)) == ["bottle.obj/mesh", "box", "gone", "round"]
    objects = FolderObjects(tmp_path, num_grasps=100, cache_dir=tmp_path / "cache")
    for name in ("gone", "round"):
        index = objects.names.index(name)
        with pytest.raises(ObjectError, match=f"{name}.obj cannot be read"):
            objects[index]
        assert f"{name}.obj cannot be read" in (objects.refusal(index) or "")
    assert objects.missing() == [0, 1]


def test_a_folder_that_cannot_be_listed_is_told(tmp_path):
    touch(tmp_path, "box.obj", "locked/mug.obj")
    (tmp_path / "locked").chmod(0)
    if os.access(tmp_path / "locked", os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.warns(UserWarning, match="locked cannot be listed"):
        assert list(find_meshes(tmp_path)) == ["box"]


def test_names_of_every_kind(tmp_path):
    names = (b"x" * 240, b"caf\xe9", "кружка".encode(), b"a\x1b[31m", b"two\nlines", "Ko\u0308ln".encode())
    for name in names:
        open(os.fsencode(tmp_path) + b"/" + name + b".obj", "wb").close()
    called = set(find_meshes(tmp_path))
    assert called == {"x" * 240, "caf\\xe9", "кружка", "a\\x1b[31m", "two\\nlines", "Köln"}
    objects = FolderObjects(tmp_path, num_grasps=100, cache_dir=tmp_path / "cache")
    for index in range(len(objects)):  # each is empty: refused by name, and that is remembered
        with pytest.raises(ObjectError):
            objects[index]
        assert objects.refusal(index)
    FolderObjects(tmp_path, num_grasps=100, include=["Köln", "Ko\u0308ln.obj", "x" * 240])


def test_two_files_of_one_name_are_told(tmp_path):
    touch(tmp_path, "Köln.obj", "Ko\u0308ln.obj")
    with pytest.raises(ObjectError, match=r"would both be called 'Köln\.obj': rename one"):
        find_meshes(tmp_path)


def test_a_name_may_be_given_with_its_suffix(tmp_path):
    touch(tmp_path, "box.obj", "mug.obj", "mug.stl")
    named = find_meshes(tmp_path)
    assert list(named) == ["box", "mug.obj", "mug.stl"]
    full = names_in_full(named, tmp_path)
    assert (full["box"], full["box.obj"], full["mug.stl"]) == ("box", "box", "mug.stl") and "mug" not in full
    assert FolderObjects(tmp_path, include=["mug.stl", "box.obj"]).names == ("mug.stl", "box")


@pytest.mark.parametrize("include", ["box", []])
def test_include_is_a_list_of_names(tmp_path, include):
    touch(tmp_path, "box.obj")
    with pytest.raises(ConfigError, match=r"^include=.*give a list of names"):
        FolderObjects(tmp_path, include=include)


def test_the_folder_is_a_path(tmp_path):
    with pytest.raises(ConfigError, match=r"^path=2024 is no path"):
        FolderObjects(2024)  # pyright: ignore[reportArgumentType]
