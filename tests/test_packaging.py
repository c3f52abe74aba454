"""What is installed: the package, and conf/ and recipes/ inside it."""

import importlib.util
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.configurations import ROOT

pytestmark = pytest.mark.checkout

BESIDE = {"torchgrasp.conf": "conf", "torchgrasp.recipes": "recipes"}


@pytest.fixture(scope="module")
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def list_files(folder: Path) -> dict[str, bytes]:
    """What of a package is installed, by its name in it."""
    files = (path for path in sorted(folder.rglob("*")) if path.suffix in (".py", ".yaml"))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_every_package_is_named(project):
    below = (path.parent for path in (ROOT / "torchgrasp").rglob("__init__.py"))
    packages = {".".join(folder.relative_to(ROOT).parts) for folder in below}
    named = project["tool"]["setuptools"]["packages"]
    assert sorted(named) == sorted({*packages, *BESIDE})
    # A folder of modules that is no package would be left out without a word.
    assert {path.parent for path in (ROOT / "torchgrasp").rglob("*.py")} == {
        ROOT.joinpath(*name.split(".")) for name in packages
    }


@pytest.mark.parametrize("name", BESIDE)
def test_configurations_and_recipes_are_importable_and_those_of_the_repository(name):
    spec = importlib.util.find_spec(name)
    assert spec is not None and spec.origin is not None, f"{name} is not installed: pip install -e . again"
    assert list_files(Path(spec.origin).parent) == list_files(ROOT / BESIDE[name])


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> set[str]:
    """Names in a wheel of the repository, built in a copy by setuptools alone."""
    pytest.importorskip("setuptools", minversion="77")
    copy = tmp_path_factory.mktemp("repository")
    for folder in ("torchgrasp", *BESIDE.values()):
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, copy)
    script = "from setuptools.build_meta import build_wheel; build_wheel('dist')"
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=copy,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": ""},
    )
    assert done.returncode == 0, done.stderr
    (file,) = (copy / "dist").glob("*.whl")
    return set(zipfile.ZipFile(file).namelist())


def test_the_wheel_holds_all_that_is_read_at_run_time(wheel):
    package = ROOT / "torchgrasp"
    read = [*package.glob("report/templates/*"), *package.glob("weights/*"), *package.glob("objects/data/*")]
    names = {path.relative_to(ROOT).as_posix() for path in read if path.is_file()}
    for folder in BESIDE.values():
        names |= {f"torchgrasp/{folder}/{name}" for name in list_files(ROOT / folder)}
    names |= {f"torchgrasp/{name}" for name in list_files(package)}
    assert len([name for name in names if name.endswith(".yaml")]) > 50
    assert names <= wheel


def test_the_wheel_holds_nothing_else(wheel):
    assert {name.split("/")[0].split("-")[0] for name in wheel} == {"torchgrasp"}
    assert not any("test" in name or "__pycache__" in name for name in wheel)


def test_no_large_file_is_tracked():
    """What history holds once, every clone carries for ever. The shipped policy has a limit of its own."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True)
    shipped = "torchgrasp/weights/pretrained.safetensors"
    files = [ROOT / name for name in listed.stdout.split("\0") if name and name != shipped]
    assert [path.name for path in files if path.exists() and path.stat().st_size > 2_000_000] == []
