"""Library errors name the argument that was given; the recipe adds its place in the configuration."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import torchgrasp

PACKAGE = Path(torchgrasp.__file__).parent
# Code that sees a configuration, or speaks to somebody who writes one; recipes lie here once installed.
MAY_NAME_OPTIONS = ("config", "commands", "recipes")
# These look options up in a finished run's config.yaml: a whole string there is a name, not a message.
READ_OPTIONS = ("evaluation/run_results.py", "report/console.py")

GROUPS = (
    *("env", "start", "physics", "objects", "camera", "overhead", "expert", "planning", "transforms"),
    *("model", "loss", "replay", "collector", "exploration", "logger", "demonstrations", "pretrain"),
    *("online", "offline", "evaluation", "checkpoint", "video"),
)
# A group's name, then its option's; not inside a path or a module's name, no file's name and no call.
OPTION = re.compile(
    rf"(?<![\w./])(?:{'|'.join(GROUPS)})\.(?!(?:py|json|ya?ml|csv|html|h5|safetensors)\b)[a-z_]\w*\b(?!\()"
)


def find_strings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every string but docstrings; "x" stands for each value of an f-string."""
    told = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):  # the whole f-string comes before its parts
        if isinstance(node, ast.JoinedStr):
            told |= {id(part) for part in node.values}
            words = (str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values)
            yield node.lineno, "".join(words)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in told:
            yield node.lineno, node.value


def find_options(source: str, *, read_options: bool = False) -> list[tuple[int, str]]:
    """Line and name of every option of the configuration that a string in `source` names."""
    return [
        (line, match[0])
        for line, text in find_strings(ast.parse(source))
        for match in OPTION.finditer(text)
        if not (read_options and re.fullmatch(r"[\w.]+", text))
    ]


def list_sources() -> list[str]:
    """Modules of the package that must not name options, relative to it."""
    names = (path.relative_to(PACKAGE) for path in sorted(PACKAGE.rglob("*.py")))
    return [name.as_posix() for name in names if name.parts[0] not in MAY_NAME_OPTIONS]


@pytest.mark.parametrize("name", list_sources())
def test_no_string_names_an_option_by_its_place(name):
    found = find_options((PACKAGE / name).read_text(), read_options=name in READ_OPTIONS)
    assert not found, f"{name} names {found}: name the argument, the recipe adds its place"


@pytest.mark.parametrize(
    "source",
    [
        'check_range("transforms.aggregate.alpha", 2, 0, 1)',
        'raise ConfigError(f"env.horizon={horizon}: give 1.")',
        'check_whole(f"physics.{name}", value, 1)',
        'remedy = "store it on disk (replay.folder=<folder>)"',
    ],
)
def test_options_in_strings_are_found(source):
    assert len(find_options(source)) == 1


@pytest.mark.parametrize(
    "source",
    [
        '"""Sees what env.horizon says."""',
        'path = folder / "evaluation.json"',
        'import_module("torchgrasp.objects.ycb")',
        'raise ConfigError(f"{run}/checkpoint.old is there: call env.reset() at the start. Then go on.")',
        'check_range("alpha", alpha, 0, 1)',
    ],
)
def test_other_strings_are_let_be(source):
    assert not find_options(source)
