"""Data flows one way: what a module may import, by where it stands."""

import ast
from pathlib import Path

import pytest

import torchgrasp

ROOT = Path(torchgrasp.__file__).parent
# None of these imports one to its right.
ORDER = ("objects", "sim", "envs", "transforms", "modules", "objectives")
# What any of them may import; these import no package of ours.
SHARED = ("errors", "keys", "geometry", "randomness", "episodes")
PACKAGES = {path.parent.name for path in ROOT.glob("*/__init__.py")}
FORBIDDEN = {
    **{name: {f"torchgrasp.{right}" for right in ORDER[place + 1 :]} for place, name in enumerate(ORDER)},
    **{name: {f"torchgrasp.{package}" for package in PACKAGES} for name in SHARED},
    "data": {"torchgrasp.modules", "torchgrasp.objectives"},
    "ops": {"tensordict", "torchrl"},
}
FORBIDDEN["transforms"] |= {"torchgrasp.data"}
FORBIDDEN["sim"] |= {"torchrl"}
FORBIDDEN["geometry"] |= {"tensordict", "torchrl"}
FORBIDDEN["objectives/functional"] = {"tensordict", "torchrl"}


def find_imports(path: Path) -> set[str]:
    """Full names of all that a file imports, inside functions as well."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def find_breaches(path: Path, forbidden: set[str]) -> set[str]:
    """The imports of a file that lie within one of the `forbidden` modules."""
    return {name for name in find_imports(path) for each in forbidden if f"{name}.".startswith(f"{each}.")}


@pytest.mark.parametrize("name", FORBIDDEN)
def test_nothing_imports_what_comes_after_it(name):
    files = sorted((ROOT / name).rglob("*.py")) or [ROOT / f"{name}.py"]
    breaches = {str(file.relative_to(ROOT)): find_breaches(file, FORBIDDEN[name]) for file in files}
    assert not {file: names for file, names in breaches.items() if names}


def test_imports_are_found_wherever_they_stand(tmp_path):
    file = tmp_path / "module.py"
    file.write_text("import torchrl.data\ndef f():\n    from torchgrasp import data\n    import torchrlib\n")
    assert find_breaches(file, {"torchrl", "torchgrasp.data"}) == {"torchrl.data", "torchgrasp.data"}
