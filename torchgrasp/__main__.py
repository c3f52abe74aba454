"""``python -m torchgrasp <command>``: tools for the command line, one module each."""

from __future__ import annotations

import argparse
import importlib
import os
import sys

from torchgrasp.errors import TorchgraspError

# A command's module has HELP, add_arguments(parser) and run(args) -> exit code. Only the chosen one is
# imported: the doctor has to run where the others' packages are broken.
COMMANDS = {
    "doctor": "torchgrasp.commands.doctor",
    "objects": "torchgrasp.commands.objects",
    "dataset": "torchgrasp.commands.dataset",
}


def main(arguments: list[str] | None = None) -> int:
    """Run one command; what a user can mend is printed in one line."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog="python -m torchgrasp")
    parser.add_argument("command", choices=COMMANDS, help="what to run; <command> --help tells its options")
    name = parser.parse_args(given[:1]).command
    module = importlib.import_module(COMMANDS[name])
    command = argparse.ArgumentParser(prog=f"python -m torchgrasp {name}", description=module.HELP)
    module.add_arguments(command)
    args = command.parse_args(given[1:])
    try:
        code = module.run(args)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except TorchgraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
