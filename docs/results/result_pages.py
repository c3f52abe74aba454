"""Pages that show tables and figures of the files, written between markers: they can be read anywhere.

`<!-- table NAME -->` and `<!-- end -->` on lines of their own hold a table. Within a sentence
`<!--fig TABLE/RECORD {template}-->95.5 %<!--/-->` holds a figure; it may not begin a line, where it would end
the paragraph.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from result_tables import (
    NOT_RECORDED,
    RESULTS,
    ROOT,
    Record,
    Table,
    find_row,
    read_table,
    show,
    shown_records,
    table_rows,
)

from torchgrasp.errors import ConfigError

_TABLE = re.compile(r"^<!-- table (\S+) -->$.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)
_FIGURE = re.compile(r"<!--fig\s(\S+)\s([^>]*?)-->[^<]*<!--/-->")
_CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
_MEASURED_CELL = re.compile(
    r"[-+]?\d[\d,.]*(?: to \d[\d,.]*)? (?:%|ms|steps/s|kB|MB|GB)(?: \[[^]]*\])?|\d+ of \d+"
)
_INTERVAL = re.compile(r"\d(?: %| points)? \[[-+]?\d+\.\d, [-+]?\d+\.\d\]")


def pages(root: Path = ROOT) -> list[Path]:
    """Every page that may show results."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def render_page(text: str, folder: Path = RESULTS) -> str:
    """A page with its tables and figures as the files have them; ConfigError names a marker that is wrong."""
    text = _TABLE.sub(lambda found: _place(render_table(found[1], folder), found[1]), text)
    text = _FIGURE.sub(lambda found: _figure(found[1], found[2], folder), text)
    left = re.search(r"^<!-- table (?!\S+ -->\n\n).*|^\s*(?:[-*] )?<!--fig.*", text, re.MULTILINE)
    if left:
        raise ConfigError(
            f"{left[0][:80]!r} is no whole marker, or begins a line: docs/benchmarks.md tells how one looks."
        )
    return text


def shown_tables(text: str) -> list[str]:
    """Names of the tables that a page shows."""
    return _TABLE.findall(text)


def find_unbound(text: str) -> list[str]:
    """Lines that state a measured figure outside of markers: it would be of no file.

    Nothing tells every measured figure from an option's value. These are figures that only a measurement
    has: a value with its interval, and a table's cell that is a share, a time, a size or a count of others.
    """
    lines = text.split("\n")
    for pattern in (_TABLE, _FIGURE, _CODE):
        text = pattern.sub(lambda found: "\n" * found[0].count("\n"), text)
    left = zip(lines, text.split("\n"), strict=True)
    return [line for line, rest in left if _INTERVAL.search(rest) or _has_measured_cell(rest)]


def _has_measured_cell(line: str) -> bool:
    cells = line.split("|")[1:-1] if line.startswith("|") else []
    return any(_MEASURED_CELL.fullmatch(cell.strip(" *")) for cell in cells)


def render_table(name: str, folder: Path = RESULTS) -> str:
    """A table in Markdown, with a line below that tells where its figures come from."""
    table = read_table(name, folder)
    columns = table.definition.columns
    lines = [[column.name for column in columns]]
    for row in table_rows(table, folder):
        bold = row.get("bold", False)
        cells = [(column.name, show(column.cell, row)) for column in columns]
        lines.append([f"**{cell}**" if cell and _is_bold(bold, name) else cell for name, cell in cells])
    text = [_line(line) for line in lines]
    text.insert(1, "|" + "---|" * len(columns))
    shown = shown_records(table, folder)
    told = [f"{table.definition.title}."]
    if table.definition.origin:
        told += [tell_origin(shown.values()), tell_notes(table, shown)]
    text += ["", *_wrapped(f"*{' '.join(filter(None, told))}*")]
    return "\n".join(text)


def tell_origin(records: Iterable[Record]) -> str:
    """Commits, versions, seeds and machines of records, those that agree in one sentence."""
    seeds: dict[tuple[str, ...], list[int]] = {}
    for record in records:
        verb = "Commit" if record.commit_is == "measured" else "Written down at commit"
        machine = "machine not recorded" if record.machine == NOT_RECORDED else record.machine
        origin = (verb, record.commit, record.versions.get("torchgrasp", "unknown"), machine)
        seeds.setdefault(origin, []).extend([] if record.seed is None else [record.seed])
    return " ".join(
        f"{verb} {commit} (version {version}){_tell_seeds(seeds[verb, commit, version, machine])}; {machine}."
        for verb, commit, version, machine in seeds
    )


def tell_notes(table: Table, records: Mapping[str, Record]) -> str:
    """What the notes of records say, in a sentence each; of which records, where it is not of all.

    Args:
        table: the table that shows the records.
        records: by table/record, as `shown_records` gives them.
    """
    places: dict[str, list[str]] = {}
    for place, record in records.items():
        for part in filter(None, record.note.split("; ")):
            places.setdefault(part, []).append(place)
    parts: dict[tuple[str, ...], list[str]] = {}
    for part, those in places.items():
        parts.setdefault(tuple(those), []).append(part)
    return " ".join(
        f"{_tell_places(table, those, records)}{'; '.join(told)}."
        if len(those) < len(records)
        else f"{told[0][0].upper()}{'; '.join(told)[1:]}."
        for those, told in parts.items()
    )


def _tell_places(table: Table, places: Sequence[str], records: Mapping[str, Record]) -> str:
    """Records by name, those of other tables by table where all that are shown of one are among them."""
    names = []
    for place in places:
        other, _, name = place.partition("/")
        shown = [each for each in records if each.startswith(f"{other}/")]
        whole = other if set(shown) <= set(places) else place
        names.append(name if other == table.name else whole)
    return f"{', '.join(f'`{name}`' for name in dict.fromkeys(names))}: "


def _tell_seeds(seeds: list[int]) -> str:
    found = sorted(set(seeds))
    return f", seed{'s' * (len(found) > 1)} {', '.join(map(str, found))}" if found else ""


def _is_bold(bold: object, column: str) -> bool:
    return column in bold if isinstance(bold, list) else bool(bold)


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells).rstrip() + " |" if cells[-1] else "| " + " | ".join(cells) + "|"


def _place(table: str, name: str) -> str:
    return f"<!-- table {name} -->\n\n{table}\n\n<!-- end -->"


def _figure(place: str, template: str, folder: Path) -> str:
    shown = show(" ".join(template.split()), find_row(place, folder))
    if not shown:
        raise ConfigError(f"{place} has no value for {template}: see docs/results/{place.split('/')[0]}.")
    return f"<!--fig {place} {template}-->{shown}<!--/-->"


def _wrapped(text: str, width: int = 100) -> Iterator[str]:
    line = ""
    for word in text.split(" "):
        if line and len(line) + 1 + len(word) > width:
            yield line
            line = word
        else:
            line = f"{line} {word}" if line else word
    yield line
