"""Data flows one way: what a module may import, by where it stands, and what a folder says of itself.

Imports count wherever they stand, inside functions and under TYPE_CHECKING as well, unless a test says
otherwise.
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import torchgrasp

pytestmark = pytest.mark.checkout

ROOT = Path(torchgrasp.__file__).parent
CHECKOUT = ROOT.parent

# Modules that anything may import, and that import one another alone.
GROUND = (
    "errors",
    "documents",
    "keys",
    "intrinsics",
    "geometry",
    "randomness",
    "episodes",
    "names",
    "interruption",
    "processes",
    "versions",
)
# Folder -> the folders that it may import, besides the ground and itself.
ALLOWED = {
    "ops": set(),
    "objects": set(),
    "data": set(),
    "sim": {"objects"},
    "modules": {"ops"},
    "runs": {"data"},
    "envs": {"objects", "sim"},
    "planning": {"objects", "sim"},
    "objectives": {"modules", "ops"},
    "transforms": {"objects", "sim", "envs"},
    "training": {"modules", "objectives", "data", "runs"},
    "rollouts": {"objects", "sim", "envs", "planning", "transforms", "data", "runs"},
}
ALLOWED["evaluation"] = {"objects", "sim", "envs", "planning", "modules", "objectives", "data"}
ALLOWED["evaluation"] |= {"rollouts", "runs"}
ALLOWED["report"] = ALLOWED["evaluation"] | {"evaluation"}
ALLOWED["config"] = set(ALLOWED)
ALLOWED["deploy"] = {"config", "data", "objects", "sim", "transforms"}
ALLOWED["commands"] = set(ALLOWED)
ALLOWED["__main__"] = {"commands", "config"}
# What is imported for annotations alone may be more: who runs episodes hands them to a learner.
ALLOWED_FOR_TYPING = {"training": {"rollouts"}, "rollouts": {"modules"}}

# Folder or module -> packages that it must do without.
WITHOUT = {
    "sim": {"torchrl"},
    "geometry": {"tensordict", "torchrl"},
    "ops": {"tensordict", "torchrl"},
    "objectives/functional": {"tensordict", "torchrl"},
}
# Package -> the folders that alone may import it, recipes and benchmarks aside.
ONLY_IN = {"sapien": {"sim"}, "mujoco": {"sim"}, "hydra": {"config"}, "omegaconf": {"config"}}
# Scripts beside the package: the packages that they may import, besides Python's own.
SCRIPTS = {"recipes": {"hydra", "numpy", "omegaconf", "tensordict", "torch", "torchgrasp", "torchrl"}}
SCRIPTS["benchmarks"] = SCRIPTS["recipes"] | {"gymnasium", "mani_skill", "onnxruntime", "psutil", "trimesh"}
# The part that takes a configuration apart: elsewhere no parameter is named `cfg`.
SEES_CFG = "config"

# Names that several files share, as one idea in several folders.
SHARED_NAMES = {
    "__init__": "every folder has one",
    "exploration": "modules has the noise, config what is configured of it",
    "grasp_prediction": "evaluation measures it, config says on what",
    "value_quality": "evaluation measures it, config says of which critic",
    "demonstration_sources": "data has what a source is, config how sources are listed",
    "exchange": "demonstrations to and from a format, in the folder of each",
    "dataset_files": "what a format's files tell of themselves, in the folder of each",
}


@dataclass(frozen=True)
class Import:
    """A full name that is imported: of a module, or of something in one."""

    name: str
    for_typing: bool = False
    in_function: bool = False

    @property
    def root(self) -> str:
        return self.name.split(".")[0]

    @property
    def lazy(self) -> bool:
        """Whether it comes after the module is loaded, or never."""
        return self.for_typing or self.in_function

    @property
    def part(self) -> str | None:
        """The folder or module of ours that it is from; None for other packages and the version."""
        root, part, *_ = *self.name.split("."), None
        return part if root == "torchgrasp" and part != "__version__" else None


def find_imports(path: Path) -> list[Import]:
    """All that a file imports, wherever it stands."""
    return list(_walk(ast.parse(path.read_text()), path))


def _walk(node: ast.AST, path: Path, for_typing: bool = False, in_function: bool = False) -> Iterator[Import]:
    if isinstance(node, ast.Import):
        yield from (Import(alias.name, for_typing, in_function) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, f"{path} imports relatively"
        yield from (Import(f"{node.module}.{alias.name}", for_typing, in_function) for alias in node.names)
    in_function |= isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    guarded = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    for child in ast.iter_child_nodes(node):
        yield from _walk(child, path, for_typing or guarded, in_function)


def list_files(name: str) -> list[Path]:
    """The Python files of a folder or module of the package, by its path below it without an ending."""
    module = ROOT / f"{name}.py"
    return [module] if module.exists() else sorted((ROOT / name).rglob("*.py"))


def tell(found: dict[Path, set[str]]) -> dict[str, list[str]]:
    """What was found, by file as seen from the checkout; nothing for files without a find."""
    return {str(file.relative_to(CHECKOUT)): sorted(names) for file, names in found.items() if names}


def find_breaches(path: Path, owner: str) -> set[str]:
    """What a file of the part `owner` imports from parts of the package that this may not import."""
    allowed = {None, owner, *GROUND, *ALLOWED.get(owner, ())}
    for_typing = allowed | ALLOWED_FOR_TYPING.get(owner, set())
    return {
        each.name
        for each in find_imports(path)
        if each.part not in (for_typing if each.for_typing else allowed)
    }


@pytest.mark.parametrize("owner", [*GROUND, *ALLOWED])
def test_a_part_imports_those_below_it_alone(owner):
    breaches = tell({file: find_breaches(file, owner) for file in list_files(owner)})
    assert not breaches


def test_each_folder_has_a_rule_and_the_rules_have_no_circle():
    assert {path.parent.name for path in ROOT.glob("*/__init__.py")} <= set(ALLOWED)
    TopologicalSorter(ALLOWED).prepare()


def test_the_package_itself_imports_its_parts_only_when_they_are_asked_for():
    at_once = {each.part for each in find_imports(ROOT / "__init__.py") if not each.lazy}
    assert at_once <= {None, *GROUND}


@pytest.mark.parametrize("folder", SCRIPTS)
def test_scripts_import_what_they_may_and_recipes_no_other_recipe(folder):
    files = sorted((CHECKOUT / folder).glob("*.py"))
    own = {file.stem for file in files} if folder == "benchmarks" else set()
    known = SCRIPTS[folder] | sys.stdlib_module_names | own
    # A benchmark times the loop of a recipe.
    hidden = {"recipes"} if folder == "recipes" else set()
    found = {}
    for file in files:
        imports = find_imports(file)
        found[file] = {each.name for each in imports if each.root not in known or each.part in hidden}
    breaches = tell(found)
    assert files
    assert not breaches


@pytest.mark.parametrize("name", WITHOUT)
def test_pure_parts_do_without_other_packages(name):
    files = list_files(name)
    found = {file: {each.name for each in find_imports(file) if each.root in WITHOUT[name]} for file in files}
    breaches = tell(found)
    assert files
    assert not breaches


@pytest.mark.parametrize("package", ONLY_IN)
def test_what_one_folder_wraps_is_imported_there_alone(package):
    files = [file for file in ROOT.rglob("*.py") if find_owner(file) not in ONLY_IN[package]]
    found = {file: {each.name for each in find_imports(file) if each.root == package} for file in files}
    breaches = tell(found)
    assert not breaches


def test_only_config_recipes_and_benchmarks_see_a_cfg():
    found = {file: find_functions_of_cfg(file) for file in ROOT.rglob("*.py") if find_owner(file) != SEES_CFG}
    breaches = tell(found)
    assert not breaches


def find_owner(file: Path) -> str:
    return file.relative_to(ROOT).parts[0].removesuffix(".py")


def find_functions_of_cfg(path: Path) -> set[str]:
    """Lines with a function that has a parameter named `cfg`."""
    lists = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.arguments)]
    named = [each for args in lists for each in (*args.posonlyargs, *args.args, *args.kwonlyargs)]
    return {f"line {each.lineno}" for each in named if each.arg == "cfg"}


@pytest.mark.parametrize("folder", ["", *(path.parent.name for path in sorted(ROOT.glob("*/__init__.py")))])
def test_the_modules_of_a_folder_import_one_another_in_no_circle(folder):
    """Imports inside functions and for annotations do not count: they come after the module is loaded."""
    files = (ROOT / folder).rglob("*.py") if folder else ROOT.glob("*.py")
    modules = {name_module(file): file for file in files}
    graph = {name: find_neighbours(name, file, modules) for name, file in modules.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def name_module(file: Path) -> str:
    return ".".join(file.relative_to(CHECKOUT).with_suffix("").parts).removesuffix(".__init__")


def find_neighbours(name: str, file: Path, modules: dict[str, Path]) -> set[str]:
    """Those of `modules` that the module `name` imports when it is loaded."""
    found = set()
    for each in find_imports(file):
        if not each.lazy:
            # "torchgrasp.data.files.check_file" is from the module "torchgrasp.data.files".
            candidates = (each.name, each.name.rpartition(".")[0])
            found |= set([module for module in candidates if module in modules][:1])
    return found - {name}


@pytest.mark.parametrize("file", sorted(ROOT.rglob("*/__init__.py")), ids=lambda file: file.parent.name)
def test_a_folder_says_what_lives_there_and_what_may_not(file):
    told = ast.get_docstring(ast.parse(file.read_text())) or ""
    assert len(re.findall(r"[.!?](?=\s|$)", told)) >= 2, f"two sentences, not {told!r}"
    assert re.search(r"\b(no|not|nothing|none|never|only|alone|elsewhere)\b", told, re.IGNORECASE)


def test_no_two_files_share_a_name_unless_they_are_one_idea():
    places = defaultdict(list)
    for file in sorted(ROOT.rglob("*.py")):
        places[file.stem].append(str(file.relative_to(ROOT)))
    shared = {name: files for name, files in places.items() if len(files) > 1 and name not in SHARED_NAMES}
    assert not shared


def test_imports_are_found_wherever_they_stand(tmp_path):
    file = tmp_path / "module.py"
    file.write_text(
        "import torchrl.data\n"
        "def f():\n    from torchgrasp import data\n    import torchrlib\n"
        "if TYPE_CHECKING:\n    from torchgrasp.rollouts import Episode\n"
    )
    assert find_imports(file) == [
        Import("torchrl.data"),
        Import("torchgrasp.data", in_function=True),
        Import("torchrlib", in_function=True),
        Import("torchgrasp.rollouts.Episode", for_typing=True),
    ]
    assert find_breaches(file, "training") == set()
    assert find_breaches(file, "objects") == {"torchgrasp.data", "torchgrasp.rollouts.Episode"}
