"""``python -m torchgrasp <command>``: tools for the command line, one module each."""

from __future__ import annotations

import argparse
import sys

from torchgrasp import doctor, object_table
from torchgrasp.errors import TorchgraspError

# A command's module has HELP, add_arguments(parser) and run(args) -> exit code.
COMMANDS = {
    "doctor": doctor,
    "objects": object_table,
}


def main(arguments: list[str] | None = None) -> int:
    """Run one command; what a user can mend is printed in one line."""
    parser = argparse.ArgumentParser(prog="python -m torchgrasp")
    commands = parser.add_subparsers(required=True, metavar="command")
    for name, module in COMMANDS.items():
        command = commands.add_parser(name, help=module.HELP, description=module.HELP)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    args = parser.parse_args(arguments)
    try:
        return args.run(args)
    except TorchgraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
