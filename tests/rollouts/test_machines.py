"""What does not travel to another machine is found there, and refused by name before anything runs.

The other machine is a Python of its own here, which is sent the functions by value, as Ray sends them.
"""

import importlib.metadata
import os
import pickle
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
import trimesh

import torchgrasp
from torchgrasp.config.environments import SplitEnv, make_pool
from torchgrasp.errors import ConfigError
from torchgrasp.objects import FolderObjects
from torchgrasp.rollouts import machines, remote_runner
from torchgrasp.rollouts.ray_pool import import_ray

FOUND = Path(torchgrasp.__file__).parents[1]
# Without -S the editable installation of a checkout would be found.
_ASKED = """
import pickle, sys
sys.path += sys.argv[2:]
from ray import cloudpickle
function, args = pickle.loads(open(sys.argv[1], "rb").read())
pickle.dump(function(*args), sys.stdout.buffer)
"""


@pytest.fixture
def ask(tmp_path):
    """Calls a function of `machines` in a Python that finds some folders and all packages but torchgrasp."""
    cloudpickle = import_ray().cloudpickle
    packages = tmp_path / "packages"
    packages.mkdir()
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if not entry.name.startswith("torchgrasp"):
            (packages / entry.name).symlink_to(entry)

    def call(function, *args, folders=(), env=None):
        sent = (machines, remote_runner)
        for module in sent:
            cloudpickle.register_pickle_by_value(module)
        try:
            packed = cloudpickle.dumps((function, args))
        finally:
            for module in sent:
                cloudpickle.unregister_pickle_by_value(module)
        (tmp_path / "call").write_bytes(packed)
        places = [*map(str, folders), str(packages)]
        command = [sys.executable, "-S", "-c", _ASKED, str(tmp_path / "call"), *places]
        told = {**os.environ, "PYTHONPATH": "", "OMP_NUM_THREADS": "1", **(env or {})}
        done = subprocess.run(command, capture_output=True, cwd=tmp_path, env=told)
        assert done.returncode == 0, done.stderr.decode()
        return pickle.loads(done.stdout)

    return call


def copy_package(folder: Path, old: str, new: str) -> Path:
    """A folder that has torchgrasp with a change in its first file."""
    shutil.copytree(FOUND / "torchgrasp", folder / "torchgrasp", ignore=shutil.ignore_patterns("__pycache__"))
    first = folder / "torchgrasp" / "__init__.py"
    assert old in first.read_text()
    first.write_text(first.read_text().replace(old, new))
    return folder


class TestVersions:
    """Of the packages that decide an episode, and of the code."""

    def test_a_checkout_like_this_one_is_not_different(self, ask):
        assert machines.tell_versions(machines.look([]), ask(machines.look, [], folders=[FOUND])) is None

    def test_a_machine_that_finds_what_this_one_does_is_not_different(self, ask):
        assert machines.tell_versions(machines.look([]), ask(machines.look, [str(FOUND)])) is None

    @pytest.mark.checkout  # where it is installed editable, and found only with its finder
    def test_no_torchgrasp(self, ask):
        assert machines.tell_versions(machines.look([]), ask(machines.look, [])) == "no torchgrasp"

    @pytest.mark.checkout  # as above
    def test_an_actor_begins_without_torchgrasp_so_that_its_machine_can_be_named(self, ask):
        def begin(runner):
            actor, found = runner([], b""), machines.look([])
            return hasattr(actor, "place"), "torchgrasp" in found

        assert ask(begin, remote_runner.RemoteRunner) == (True, False)

    def test_another_torchgrasp(self, ask, tmp_path):
        here = machines.look([])
        folder = copy_package(tmp_path, f'__version__ = "{here["torchgrasp"]}"', '__version__ = "0.1.0"')
        told = machines.tell_versions(here, ask(machines.look, [], folders=[folder]))
        assert told == f"torchgrasp 0.1.0 in place of {here['torchgrasp']}"

    def test_the_same_version_with_other_code(self, ask, tmp_path):
        here = machines.look([])
        folder = copy_package(tmp_path, "loads nothing else", "loads nothing more")
        told = machines.tell_versions(here, ask(machines.look, [], folders=[folder]))
        assert told == f"other code of torchgrasp {here['torchgrasp']}"

    @pytest.mark.parametrize("package", ["torch", "ray"])
    def test_another_version_of_a_package(self, ask, tmp_path, package):
        folder = older(tmp_path, package)
        told = machines.tell_versions(machines.look([]), ask(machines.look, [], folders=[folder, FOUND]))
        ours = importlib.metadata.version(package).partition("+")[0]
        assert told == f"{package} 0.0.1 in place of {ours}"

    def test_a_build_for_another_processor_is_of_the_same_version(self):
        here = machines.look([])
        assert "+" not in here["torch"] and importlib.metadata.version("torch").startswith(here["torch"])


def older(folder: Path, package: str) -> Path:
    """A folder whose metadata say that an old version of a package is installed."""
    metadata = folder / f"{package}-0.0.1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.0.1\n")
    return folder


@pytest.fixture
def meshes(tmp_path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    for name, height in (("low", 0.08), ("high", 0.12)):
        trimesh.creation.box((0.05, 0.06, height)).export(folder / f"{name}.stl")
    return folder


class TestIngredients:
    """Of the environments: what they are made from must be there, and be the same."""

    @pytest.fixture
    def packed(self, composed, meshes) -> bytes:
        cfg = composed("experiment=smoke", "objects=folder", f"objects.path={meshes}")
        return pickle.dumps({"train": SplitEnv(cfg, "train")})

    def test_the_same_files_are_not_different(self, ask, packed):
        here, there = machines.look_inside([], packed), ask(machines.look_inside, [], packed, folders=[FOUND])
        assert set(here["train"]) == {"low", "high"}
        assert machines.tell_ingredients(here, there) is None

    def test_a_path_of_this_machine_alone(self, ask, packed, meshes):
        meshes.rename(meshes.parent / "elsewhere")
        there = ask(machines.look_inside, [], packed, folders=[FOUND])
        assert there == f"objects: {meshes} is not a directory: give the folder that holds the mesh files."

    def test_other_files_under_the_same_path(self, ask, packed, meshes):
        here = machines.look_inside([], packed)
        trimesh.creation.box((0.05, 0.06, 0.10)).export(meshes / "low.stl")
        there = ask(machines.look_inside, [], packed, folders=[FOUND])
        assert machines.tell_ingredients(here, there) == "another low for the environment 'train'"

    def test_files_that_lack_or_are_more(self, ask, packed, meshes):
        here = machines.look_inside([], packed)
        (meshes / "low.stl").rename(meshes / "lower.stl")
        there = ask(machines.look_inside, [], packed, folders=[FOUND])
        assert machines.tell_ingredients(here, there) == "no low for the environment 'train'"
        del here["train"]["low"]
        assert machines.tell_ingredients(here, there) == "also lower for the environment 'train'"

    def test_a_cache_that_cannot_be_written(self, ask, packed, tmp_path):
        (tmp_path / "file").touch()
        env = {"TORCHGRASP_CACHE": str(tmp_path / "file" / "cache")}
        there = ask(machines.look_inside, [], packed, folders=[FOUND], env=env)
        assert there.startswith(
            f"2 objects are not in the cache {tmp_path}/file/cache/objects, which cannot be"
        )

    def test_a_cache_that_holds_all_need_not_be_written(self, meshes, tmp_path):
        objects = FolderObjects(meshes, cache_dir=tmp_path / "cache")
        assert objects.obstacle() is None
        objects.cache_dir = meshes / "low.stl"
        assert "set TORCHGRASP_CACHE" in objects.obstacle()

    def test_a_package_that_is_missing(self, ask, packed):
        there = ask(machines.look_inside, [], packed)
        assert there == "No module named 'torchgrasp'"


def test_many_differences_are_counted():
    here = {"train": dict.fromkeys("abcdefg", "x")}
    told = machines.tell_ingredients(here, {"train": {}})
    assert told == "no a, b, c and 4 more for the environment 'train'"


@pytest.mark.slow
def test_a_machine_is_refused_by_name_before_anything_runs(composed, tmp_path):
    """Ray that runs already, whose workers find an older torch than this process."""
    ray = import_ray()
    workers = {"env_vars": {"PYTHONPATH": str(older(tmp_path, "torch"))}}
    ray.init("local", num_cpus=1, include_dashboard=False, runtime_env=workers, logging_level="warning")
    try:
        cfg = composed("experiment=smoke", "collector=ray", "collector.num_workers=1")
        told = r"^Machines of the Ray cluster .* \(.*\) has torch 0.0.1 in place of .*: install the"
        with pytest.raises(ConfigError, match=told):
            make_pool(cfg)
        by_value = ray.cloudpickle.list_registry_pickle_by_value()
        assert remote_runner.__name__ in by_value  # so that a machine that joins late can be named
    finally:
        ray.shutdown()
