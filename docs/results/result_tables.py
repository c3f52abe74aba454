"""Tables of results: one folder a table, with its definition in table.json and a small JSON a record.

A record is what one command gave: where it was measured, and the rows that it gives to the table. A row is
a mapping of values by name, nested where it has several measurements, in SI units and rates from 0 to 1 as in
summary.json. A cell of a table is a template over a row's values; see `show`.
"""

from __future__ import annotations

import re
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from result_differences import Pairs, difference_rows
from result_plans import Plan, planned_row, planned_rows, record_seeds, records_of
from result_records import NOT_RECORDED as NOT_RECORDED
from result_records import RESULTS, ROOT, Record, Words

from torchgrasp.documents import Document, Name, Plain, check_document, read_document, read_json
from torchgrasp.errors import ConfigError

_REMEDY = "docs/benchmarks.md tells how a table and a record look"


class Column(Document):
    """One column: its heading, and the template of its cells."""

    name: Name
    cell: Words


class Definition(Document):
    """A table.

    Attributes:
        title: what it shows, in a line.
        columns: from left to right.
        key: the value by which rows of several records are one row; None keeps every row by itself.
        records: by name, in the table's order; of the file `source` where that is given.
        source: a JSON file below the repository whose `results` hold the records by name.
        rows: where the table is no plain list of its records' rows: mappings of values, in which
            "@table/record" stands for that record's first row, "@table/record#3" for its fourth and
            "@table/record.name" for a mapping of it. Under the name "*" its values stand in the row. Of a
            table with a plan, runs stand in place of records.
        reads: what of a command's output makes the rows. "summary": the success of summary.json, in the row
            or in the one mapping of it that holds a success; where that has an `of`, the success of this
            name in the summary's `comparison`. "benchmark": the rows of benchmark.json as they are. None:
            `run` cannot make the table again.
        plan: the runs that give records and rows, in place of `records`: there may be none of them yet.
        compares: the rows of a planned table whose differences are the rows.
        origin: whether a line below the table tells commits and machines.
    """

    title: Words
    columns: Annotated[list[Column], Field(min_length=1)]
    key: Name | None = None
    records: list[Name] = Field([])
    source: Name | None = None
    rows: list[Plain] = Field([])
    reads: Literal["summary", "benchmark"] | None = None
    plan: Plan | None = None
    compares: Pairs | None = None
    origin: bool = True


@dataclass(frozen=True)
class Table:
    """A definition and the records it names."""

    name: str
    definition: Definition
    records: Mapping[str, Record]


def table_names(folder: Path = RESULTS) -> list[str]:
    """Every table's name, sorted."""
    return sorted(path.parent.name for path in folder.glob("*/table.json"))


def read_table(name: str, folder: Path = RESULTS) -> Table:
    """Read a table's definition and records; ConfigError names what is missing or does not belong there."""
    if name not in table_names(folder):
        raise ConfigError(f"{name} is no table: choose from {', '.join(table_names(folder))}.")
    definition = read_document(folder / name / "table.json", Definition, _REMEDY, error=ConfigError)
    if definition.source is None:
        names = definition.records
        there = {path.stem for path in (folder / name).glob("*.json")} - {"table"}
        if definition.plan is not None:  # what was not run yet has no record
            names = [each for each in record_seeds(definition.plan) if each in there]
        if there != set(names):
            wrong = ", ".join(sorted(there ^ set(names)))
            raise ConfigError(f"{name}/table.json and its folder do not agree on the records {wrong}.")
        values = {each: read_json(record_path(name, each, folder), _REMEDY) for each in names}
    else:
        source = read_json(ROOT / definition.source, _REMEDY)["results"]
        values = {each: source[each] for each in definition.records}
    records = {
        each: check_document(value, Record, f"{name}/{each}.json", _REMEDY, error=ConfigError)
        for each, value in values.items()
    }
    return Table(name, definition, records)


def record_path(table: str, record: str, folder: Path = RESULTS) -> Path:
    """The file of a record."""
    return folder / table / f"{record}.json"


def table_rows(table: Table, folder: Path = RESULTS) -> list[dict[str, Any]]:
    """The rows in order: those of its records, joined by `key`, of its plan, or those of other tables."""
    if table.definition.plan is not None:
        return planned_rows(table.definition.plan, table.records)
    if table.definition.compares is not None:
        compared = read_planned(table.definition.compares.table, folder)
        return difference_rows(table.definition.compares, *compared)
    given = [_resolve(row, folder) for row in table.definition.rows]
    rows = given or [dict(row) for record in table.records.values() for row in record.rows]
    if table.definition.key is None:
        return rows
    joined: dict[Any, dict[str, Any]] = {}
    for row in rows:
        joined.setdefault(row[table.definition.key], {}).update(row)
    return list(joined.values())


def shown_records(table: Table, folder: Path = RESULTS) -> dict[str, Record]:
    """The records that a table shows, its own and those of other tables, by table/record."""
    own, plan = table.records, table.definition.plan
    if plan is not None:  # what was run hides what a page told
        chosen = {run: records_of(plan, run, table.records) for run in plan.runs}
        own = {f"{run}_{seed}": each for run, those in chosen.items() for seed, each in those.items()}
    found = {f"{table.name}/{name}": record for name, record in own.items()}
    for row in table.definition.rows:
        for value in row.values():
            if isinstance(value, str) and value.startswith("@"):
                found |= _find_records(re.split(r"[#.]", value[1:])[0], folder)
    return found


def read_planned(name: str, folder: Path = RESULTS) -> tuple[Plan, Mapping[str, Record]]:
    """The plan and the records of a table; ConfigError where it has no plan."""
    table = read_table(name, folder)
    if table.definition.plan is None:
        raise ConfigError(f"{name}/table.json has no plan, whose rows could be compared.")
    return table.definition.plan, table.records


def find_record(place: str, folder: Path = RESULTS) -> Record:
    """The record of "table/record"; ConfigError where there is none."""
    table, _, record = place.partition("/")
    records = read_table(table, folder).records
    if record not in records:
        raise ConfigError(f"{place} is no record: {table} has {', '.join(records)}.")
    return records[record]


def find_row(place: str, folder: Path = RESULTS) -> dict[str, Any]:
    """The row of "table/record", of "table/record#2" its third, of "table/record.name" that mapping of it.

    Of a table with a plan, "table/run" is the row of all of the run's seeds.
    """
    whole, _, name = place.partition(".")
    row = _find_whole_row(whole, folder)
    found = row if not name else row.get(name)
    if not isinstance(found, dict):
        raise ConfigError(f"{place}: the row has no mapping {name}.")
    return found


def _find_whole_row(place: str, folder: Path) -> dict[str, Any]:
    record, _, index = place.partition("#")
    table, _, run = place.partition("/")
    definition = read_table(table, folder).definition
    if definition.plan is not None:
        return planned_row(definition.plan, run, read_table(table, folder).records)
    rows, number = find_record(record, folder).rows, int(index or 0)
    if number >= len(rows):
        raise ConfigError(f"{place}: the record has {len(rows)} rows, counted from 0.")
    return rows[number]


def _find_records(place: str, folder: Path) -> dict[str, Record]:
    """The record of "table/record", or those of "table/run", by their places."""
    table, _, run = place.partition("/")
    read = read_table(table, folder)
    if read.definition.plan is None:
        return {place: find_record(place, folder)}
    chosen = records_of(read.definition.plan, run, read.records)
    return {f"{table}/{run}_{seed}": record for seed, record in chosen.items()}


def _resolve(row: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in row.items():
        refers = isinstance(value, str) and value.startswith("@")
        taken: Any = find_row(value[1:], folder) if refers else value
        found.update(taken if name == "*" else {name: taken})
    return found


class _Cell(string.Formatter):
    """Templates whose fields are dotted names of a row's values."""

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> tuple[Any, str]:
        """The value that a dotted name leads to; KeyError where there is none."""
        value: Any = kwargs
        for part in field_name.split("."):
            value = value[int(part)] if isinstance(value, list) else value[part]
        return value, field_name

    def format_field(self, value: Any, format_spec: str) -> str:
        """Format by Python's rules and by those of `show`."""
        if format_spec.startswith("pct"):
            return f"{100 * value:.{format_spec[3:] or 1}f} %"
        if format_spec == "minutes":
            return f"{value / 60:,.0f}"
        if format_spec.startswith("ms"):
            return f"{1e3 * value:,.{format_spec[2:] or 0}f}"
        if format_spec == "rate":
            return f"{100 * value:.1f}"
        if format_spec in ("ci", "to"):
            low, high = (f"{100 * end:.1f}" for end in value)
            return f"[{low}, {high}]" if format_spec == "ci" else f"{low} to {high}"
        if format_spec in ("rates", "sets"):
            told = ["-" if each is None else f"{100 * each:.1f}" for each in value]
            return (", " if format_spec == "rates" else " / ").join(told)
        if format_spec == "mean":
            return f"{100 * sum(value) / len(value):.1f}"
        if format_spec == "points":
            return " / ".join("-" if each is None else f"{each:+.1f}" for each in value)
        if format_spec.startswith("average"):
            return format(sum(value) / len(value), format_spec.removeprefix("average"))
        if format_spec == "success":
            return show("{success_rate:pct} {success_ci95:ci}", value)
        return format(value, format_spec)


def show(template: str, row: Mapping[str, Any]) -> str:
    """A template filled from a row; empty where the row lacks a value of it.

    Fields are dotted names, formatted as in Python (`{milliseconds:,.0f}`) or by these words: `pct` (0.955 is
    95.5 %, `pct0` without decimals), `rate` (the same without the sign), `rates` and `mean` (of a list),
    `sets` (73.6 / 65.6, - where one is not known), `points` (+3.1 / -, of differences in points),
    `average.3f` (the mean of any values, in Python's format), `ci` (an interval of rates as [93.0, 97.1]),
    `to` (as 93.0 to 97.1), `success` (rate and interval of a success table), `ms` (seconds in milliseconds,
    `ms1` with a decimal), `minutes` (seconds in minutes).

    >>> show("{now.success_rate:pct} {now.success_ci95:ci}, {x:.2f} m", {"x": 1, "now": {"success_rate": 0.5,
    ...     "success_ci95": [0.25, 0.75]}})
    '50.0 % [25.0, 75.0], 1.00 m'
    """
    try:
        return _Cell().vformat(template, (), row)
    except (KeyError, IndexError, TypeError):
        return ""
