"""Tables of results from files: python docs/results render | check | old | list | run <table>."""

from __future__ import annotations

import argparse
import sys

from result_ages import tell_old
from result_pages import find_unbound, pages, render_page
from result_runs import run_table
from result_tables import ROOT, read_table, table_names

from torchgrasp.errors import TorchgraspError


def render() -> None:
    """Write every page's tables and figures anew."""
    for page in pages():
        text = page.read_text()
        if (new := render_page(text)) != text:
            page.write_text(new)
            print(f"Written: {page.relative_to(ROOT)}")


def check() -> int:
    """Name pages that do not show what the files hold, or state what none holds; 1 where there are any."""
    wrong = 0
    for page in pages():
        text, name = page.read_text(), page.relative_to(ROOT)
        if render_page(text) != text:
            print(f"{name} does not show what the files hold: run python docs/results render.")
            wrong = 1
        for line in find_unbound(text):
            print(
                f"{name} states a figure that is of no file; docs/benchmarks.md tells how to add one: {line}"
            )
            wrong = 1
    return wrong


def list_tables() -> None:
    """Print each table's name, how many records it has, whether it can be run again, and its title."""
    for name in table_names():
        definition = read_table(name).definition
        how = "run" if definition.reads else ""
        print(f"{name:28} {len(definition.records):3} {how:4} {definition.title}")


def main(arguments: list[str]) -> int:
    """Do what the arguments ask for and return the exit code."""
    parser = argparse.ArgumentParser(prog="python docs/results", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("render", help="write the tables and figures of every page anew")
    commands.add_parser("check", help="tell whether the pages show what the files hold, and no more")
    commands.add_parser("list", help="name the tables")
    old = commands.add_parser("old", help="tell rows of another version, or whose origin is not known")
    old.add_argument("tables", nargs="*", help="all, where none is named")
    old.add_argument("--since", help="rows before this commit, or before the last change of this path, alone")
    run = commands.add_parser("run", help="run a table's commands again and write its records")
    run.add_argument("table")
    run.add_argument("--only", nargs="+", help="these records alone")
    run.add_argument("--again", action="store_true", help="also those of the present version")
    given = parser.parse_args(arguments)
    try:
        if given.command == "old":
            tell_old(given.tables or table_names(), given.since)
        elif given.command == "run":
            run_table(given.table, only=given.only, again=given.again)
            render()
        elif given.command == "check":
            return check()
        else:
            {"render": render, "list": list_tables}[given.command]()
    except TorchgraspError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
