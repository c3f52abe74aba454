"""The command line: recipes by name and tools; what is not asked for is not imported."""

import subprocess
import sys

import pytest

from tests.configurations import ROOT
from torchgrasp import __version__
from torchgrasp.commands.command_line import RECIPES, TOOLS, main

# Runs `python -m torchgrasp` in this interpreter, and tells what was loaded.
SCRIPT = """
import runpy, sys
sys.argv = ["torchgrasp", *sys.argv[1:]]
try:
    runpy.run_module("torchgrasp", run_name="__main__")
except SystemExit as ended:
    print("ended with", ended.code)
print("loaded", [name for name in ("torch", "numpy", "sapien", "hydra") if name in sys.modules])
"""


def start(*arguments: str, script: str | None = None):
    program = ["-m", "torchgrasp"] if script is None else ["-c", script]
    command = [sys.executable, *program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    "arguments", [["--help"], ["objects", "--help"], ["dataset", "--help"], ["--version"]]
)
def test_help_is_told_without_loading_anything(arguments):
    out = start(*arguments, script=SCRIPT).stdout
    assert out.splitlines()[-2:] == ["ended with 0", "loaded []"]
    if arguments == ["--help"]:
        assert all(f"  {name} " in out for name in (*RECIPES, *TOOLS))


def test_recipes_are_the_scripts_of_their_folder():
    assert set(RECIPES) == {path.stem for path in (ROOT / "recipes").glob("*.py")} - {"__init__"}


@pytest.mark.parametrize("name", TOOLS)
def test_every_tool_tells_its_options(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0 and f"usage: torchgrasp {name}" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["nobody"], [], ["td3"]])
def test_an_unknown_command_exits_with_2_and_names_the_known_ones(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    error = capsys.readouterr().err
    assert ended.value.code == 2 and "usage: torchgrasp" in error
    assert not arguments or ("td3_bc" in error and "doctor" in error)


def test_the_version_is_the_packages(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"torchgrasp {__version__}\n"


def test_a_recipe_runs_with_its_overrides_and_its_exit_code():
    done = start("evaluate", "policy=nobody")
    assert done.returncode == 1 and done.stderr.startswith("error: policy='nobody' is not there: give expert")
    assert done.stderr.count("\n") == 1 and not done.stdout
