"""A recipe's command line: Hydra's, on which paths are given as they are."""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import hydra.version
from hydra._internal.utils import _run_hydra, get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException
from omegaconf import DictConfig

from torchgrasp.names import write_out_what_cannot_be_encoded


def recipe_main(
    *, config_name: str, config_path: str = "../conf"
) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Let a function run from the command line with the configuration that its overrides compose.

    `hydra.main(version_base=None, ...)` with three differences. A value for which Hydra has no reading is
    taken as it is written: `objects.path=/data/a=b`, `~/meshes` and `/data/Köln (new)` need no quotes but the
    shell's. What is given for a group and is no name, as `model=5`, is one line instead of a traceback. And
    no configuration is unpickled (`--experimental-rerun`).

    Args:
        config_name: the file, without its suffix.
        config_path: its folder, relative to the recipe.

    Example:
        >>> @recipe_main(config_name="evaluate")
        ... def main(cfg): ...
    """

    def decorate(task: Callable[[DictConfig], None]) -> Callable[[], None]:
        conf = Path(inspect.unwrap(task).__code__.co_filename).parent / config_path

        @functools.wraps(task)
        def run() -> None:
            hydra.version.setbase(None)
            write_out_what_cannot_be_encoded()
            parser = get_args_parser()
            args = parser.parse_args()
            if args.experimental_rerun is not None:
                parser.error("--experimental-rerun unpickles a file, which could run anything")
            args.overrides = [as_written(each) for each in args.overrides]
            if (fault := find_fault(conf, args.overrides)) is not None:
                parser.exit(1, f"error: {fault}\n")
            _run_hydra(args, parser, task, config_path, config_name)

        return run

    return decorate


def as_written(override: str) -> str:
    """An override, with its value in quotes where Hydra could not read it; a leading `~` is expanded there.

    Commas between values keep their meaning: a sweep over each of them.

    >>> as_written("seed=3"), as_written("objects.path=/data/a=b")
    ('seed=3', "objects.path='/data/a=b'")
    >>> as_written("objects.path=/data/a=b,/data/c")
    "objects.path='/data/a=b',/data/c"
    """
    name, equals, value = override.partition("=")
    parts = value.split(",")
    if not equals or _is_readable(override) or any(map(_is_notation, parts)):
        return override
    quoted = [each if _is_readable(f"{name}={each}") else _quote(each) for each in parts]
    written = f"{name}={','.join(quoted)}"
    return written if _is_readable(written) else override


def find_fault(conf: Path, overrides: Iterable[str]) -> str | None:
    """What is wrong with the first override that cannot be read, or gives a group no file of `conf`."""
    for override in overrides:
        try:
            parsed = OverridesParser.create().parse_override(override)
        except HydraException as error:
            reason = str(error).splitlines()[0]
            return f"{override} cannot be read ({reason}): close its brackets and quotes."
        folder = conf / parsed.key_or_group
        if parsed.is_sweep_override() or parsed.is_delete() or not folder.is_dir() or not parsed.value_type:
            continue
        value = parsed.value()
        if not isinstance(value, str) and not (
            isinstance(value, list) and all(isinstance(each, str) for each in value)
        ):
            choices = ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
            return f"{override} is no choice: give one of {choices}."
    return None


def _is_readable(override: str) -> bool:
    try:
        OverridesParser.create().parse_override(override)
    except HydraException:
        return False
    return True


def _is_notation(value: str) -> bool:
    """Whether a value begins as a list, mapping, quoted text or call: Hydra tells what is wrong with it."""
    call = re.match(r"\s*(\w+)\s*\(", value)
    functions = OverridesParser.create().functions.functions
    return value.lstrip().startswith(("[", "{", "'", '"')) or (call is not None and call[1] in functions)


def _quote(value: str) -> str:
    return QuotedString(os.path.expanduser(value), Quote.single).with_quotes()
