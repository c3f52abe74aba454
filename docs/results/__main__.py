"""Tables of results from files: python docs/results render | check | old | list | run <table>."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from result_ages import tell_old
from result_pages import find_unbound, pages, render_page
from result_plan_runs import run_plan
from result_runs import run_table
from result_tables import ROOT, read_table, table_names

from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.interruption import Interrupted


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
        table = read_table(name)
        how = "run" if table.definition.reads else ""
        print(f"{name:28} {len(table.records):3} {how:4} {table.definition.title}")


def run(table: str, only: Sequence[str] | None, again: bool, jobs: int) -> None:
    """Run a table's commands and write the pages anew, also where it was stopped or some failed."""
    try:
        if read_table(table).definition.plan is not None:
            run_plan(table, only=only, again=again, jobs=jobs)
        elif jobs != 1:
            raise ConfigError(f"--jobs is for tables with a plan; {table} runs its commands one by one.")
        else:
            run_table(table, only=only, again=again)
    finally:
        render()


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
    running = commands.add_parser("run", help="run a table's commands again and write its records")
    running.add_argument("table")
    running.add_argument("--only", nargs="+", help="these records alone; of a plan, these runs")
    running.add_argument("--again", action="store_true", help="also those of the present version")
    running.add_argument("--jobs", type=int, default=1, help="so many runs of a plan side by side")
    given = parser.parse_args(arguments)
    try:
        if given.command == "old":
            tell_old(given.tables or table_names(), given.since)
        elif given.command == "run":
            run(given.table, given.only, given.again, given.jobs)
        elif given.command == "check":
            return check()
        else:
            {"render": render, "list": list_tables}[given.command]()
    except Interrupted as stopped:
        print(f"{stopped}. The same command goes on with what is missing.", file=sys.stderr)
        return stopped.exit_code
    except TorchgraspError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
