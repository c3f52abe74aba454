"""``torchgrasp <command>``: the recipes by name, and tools, one module each.

Only the chosen command is imported: help answers at once, and the doctor runs where packages are broken.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import sys

from torchgrasp import __version__
from torchgrasp.errors import TorchgraspError
from torchgrasp.names import one_line, write_out_what_cannot_be_encoded

# A tool's module has HELP, add_arguments(parser) and run(args) -> exit code; it imports what it needs in run.
TOOLS = {
    "doctor": "what works on this machine, and how to mend the rest",
    "objects": "build a set of objects and list which of them can be grasped",
    "dataset": "check, print, export or import a folder of demonstrations",
    "average": "one policy of several that were trained on from the same start",
    "export": "write a trained policy for machines without torchgrasp, or without torch",
}
RECIPES = {
    "td3_bc": "train actor and critic: demonstrations, imitation, reinforcement, evaluation",
    "bc": "train a policy by imitation and DAgger",
    "hindsight": "fine-tune a policy on objects without models",
    "collect": "collect demonstrations",
    "evaluate": "success of a policy on unseen scenes",
    "view": "watch a policy in the browser",
    "compare": "runs side by side, with intervals",
    "curves": "learning curves over seeds",
    "pendulum": "TorchRL's pendulum by this library's losses",
}


def main(arguments: list[str] | None = None) -> int:
    """Run one command; what a user can mend is printed in one line."""
    given = sys.argv[1:] if arguments is None else arguments
    name = _make_parser().parse_args(given[:1]).command
    return _run_recipe(name, given[1:]) if name in RECIPES else _run_tool(name, given[1:])


def _make_parser() -> argparse.ArgumentParser:
    lines = ["recipes (Hydra overrides follow, as in `torchgrasp td3_bc seed=1`):"]
    lines += [f"  {name:10} {words}" for name, words in RECIPES.items()]
    lines += ["tools (options follow):", *(f"  {name:10} {words}" for name, words in TOOLS.items())]
    parser = argparse.ArgumentParser(
        prog="torchgrasp",
        usage="torchgrasp <command> [options]",
        epilog="\n".join(lines),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"torchgrasp {__version__}")
    parser.add_argument(
        "command",
        choices=(*RECIPES, *TOOLS),
        metavar="command",
        help="what to run; `torchgrasp <command> --help` tells its options",
    )
    return parser


def _run_recipe(name: str, overrides: list[str]) -> int:
    """Become the recipe: Hydra then reads a command line of its own, and signals need no forwarding."""
    module = f"torchgrasp.recipes.{name}"
    if importlib.util.find_spec("torchgrasp.recipes") is None:
        print(
            f"error: {module} is not installed: install the wheel, or in a checkout pip install -e .",
            file=sys.stderr,
        )
        return 1
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", module, *overrides])


def _run_tool(name: str, options: list[str]) -> int:
    module = importlib.import_module(f"torchgrasp.commands.{name}")
    parser = argparse.ArgumentParser(prog=f"torchgrasp {name}", description=module.HELP)
    module.add_arguments(parser)
    args = parser.parse_args(options)
    write_out_what_cannot_be_encoded()
    try:
        code = module.run(args)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except TorchgraspError as error:
        print("error:", one_line(error), file=sys.stderr)
        return 1
