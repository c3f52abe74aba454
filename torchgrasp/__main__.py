"""`python -m torchgrasp <command>`: one module a command."""

from __future__ import annotations

import argparse

from torchgrasp import doctor


def main(arguments: list[str] | None = None) -> int:
    """Run the command; its exit code."""
    parser = argparse.ArgumentParser(prog="python -m torchgrasp", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")
    doctor.add_parser(commands)
    options = parser.parse_args(arguments)
    return options.run(options)


if __name__ == "__main__":
    raise SystemExit(main())
