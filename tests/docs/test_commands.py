"""Every command of a recipe in README, documentation and records of results names options that exist."""

import re
import shlex
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from result_tables import read_table, table_names

_ROOT = Path(__file__).parents[2]
_PAGES = [_ROOT / "README.md", *sorted((_ROOT / "docs").rglob("*.md"))]
_FENCE = re.compile(r"^```bash\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def _lines():
    """Every line of a page's bash blocks, and every record's command."""
    for block in (block for page in _PAGES for block in _FENCE.findall(page.read_text())):
        yield from block.replace("\\\n", " ").splitlines()
    for table in map(read_table, table_names()):
        for record in table.records.values():
            yield from (record.command, *record.needs)
        if (plan := table.definition.plan) is not None:
            yield from plan.folders.values()
            yield from (run.command for run in plan.runs.values())


def _commands():
    """Distinct (recipe, overrides) of all commands that run one; <placeholders> become a word."""
    found = {}
    for line in _lines():
        words = shlex.split(re.sub(r"<[^>]*>", "word", line), comments=True)
        if len(words) > 1 and (recipe := _recipe(*words[:2])) is not None:
            found[" ".join(words)] = (recipe, words[2:])
    return found


def _recipe(program, argument):
    """The script of `python recipes/<name>.py`, `torchgrasp <name>` or `python benchmarks/<name>.py`."""
    if argument.startswith(("recipes/", "benchmarks/")):
        return _ROOT / argument
    script = _ROOT / "recipes" / f"{argument}.py"
    return script if program == "torchgrasp" and script.exists() else None


@pytest.mark.parametrize(("recipe", "overrides"), _commands().values(), ids=_commands())
def test_command_names_a_recipe_and_options_that_exist(recipe, overrides):
    name = re.search(r'config_name="(\w+)"', recipe.read_text())
    assert name is not None
    folder = "conf" if recipe.parent.name == "recipes" else "benchmarks"
    with initialize_config_dir(str(_ROOT / folder), version_base=None):
        if "-m" in overrides:
            parsed = OverridesParser.create().parse_overrides([each for each in overrides if each != "-m"])
            (jobs,) = BasicSweeper.split_arguments(parsed, max_batch_size=None)
            overrides = jobs[-1]
        compose(name[1], overrides)


def test_commands_of_pages_and_records_are_found():
    assert len(_commands()) >= 100
