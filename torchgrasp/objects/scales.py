"""Tables of scales: one factor to metres a named object, as a CSV or YAML file."""

from __future__ import annotations

import csv
import io
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from reprlib import repr as short
from typing import Any

import yaml

from torchgrasp.errors import ConfigError
from torchgrasp.names import to_path

# Factors to metres that files can need: an angstrom is 1e-10 m, a kilometre 1e3 m.
LEAST, GREATEST = 1e-12, 1e6
_MOST_BYTES = 10_000_000


def read_scales(path: str | Path, names: Mapping[str, str]) -> dict[str, float]:
    """The factors of a table by object, which may name only some of them.

    Args:
        path: ``name,scale`` lines in a .csv file, or ``name: scale`` in a .yaml file. A CSV file may begin
            with a heading and a byte order mark. Semicolons or tabs may stand for commas, and with them
            0,001 for 0.001.
        names: the objects' names by what the table may call them.
    """
    file = to_path("scale_table", path)
    scales: dict[str, float] = {}
    for called, value in _rows(file):
        name = names.get(unicodedata.normalize("NFC", called))
        if name is None:
            known = ", ".join(dict.fromkeys(names.values()))
            raise ConfigError(
                f"{file} has {short(called)}, which is no object of the folder: it holds {known[:400]}."
            )
        if name in scales:
            raise ConfigError(f"{file} has {name!r} twice: leave one out.")
        scales[name] = _factor(file, name, value)
    return scales


def _factor(file: Path, name: str, value: Any) -> float:
    try:
        factor = float(value)
    except (TypeError, ValueError):
        factor = float("nan")
    if not LEAST <= factor <= GREATEST:
        raise ConfigError(
            f"{file} scales {name} by {short(value)}: give a positive factor to metres, at most {GREATEST:g}."
        )
    return factor


def _rows(file: Path) -> list[tuple[str, Any]]:
    text = _read(file)
    if file.suffix.lower() in (".yaml", ".yml"):
        return _yaml_rows(file, text)
    if file.suffix.lower() != ".csv":
        raise ConfigError(f"scale_table={file}: give a file that ends in .csv, .yaml or .yml.")
    return _csv_rows(file, text)


def _read(file: Path) -> str:
    try:
        if file.exists() and not file.is_file():
            raise OSError("it is no regular file")
        if file.stat().st_size > _MOST_BYTES:
            raise OSError(f"it is larger than {_MOST_BYTES / 1e6:.0f} MB")
        return file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"scale_table={file} is not UTF-8 (byte {error.start}): save it as 'CSV UTF-8' or in UTF-8."
        ) from error
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(
            f"scale_table={file} cannot be read ({reason}): give a CSV or YAML file."
        ) from error


def _csv_rows(file: Path, text: str) -> list[tuple[str, Any]]:
    first = next((line for line in text.splitlines() if line.strip()), "")
    mark = next((each for each in ";\t" if each in first), ",")
    try:
        rows = [_cells(row) for row in csv.reader(io.StringIO(text, newline=""), delimiter=mark)]
    except csv.Error as error:
        raise ConfigError(f"{file} is no CSV file ({error}): each line is 'name,scale'.") from error
    rows = [row for row in rows if row]
    if rows and [cell.lower() for cell in rows[0]] == ["name", "scale"]:
        del rows[0]
    for row in rows:
        if len(row) != 2:
            raise ConfigError(f"{file} has the line {short(mark.join(row))}: each is 'name{mark}scale'.")
    return [(name, value if mark == "," else value.replace(",", ".")) for name, value in rows]


def _cells(row: list[str]) -> list[str]:
    """The words of a line, without the empty cells that spreadsheets leave at its end."""
    words = [word.strip() for word in row]
    while words and not words[-1]:
        del words[-1]
    return words


def _yaml_rows(file: Path, text: str) -> list[tuple[str, Any]]:
    try:
        # As text throughout: 025 and yes are names, and every factor is read as in a CSV file.
        table = yaml.load(text, Loader=yaml.BaseLoader)
    except (yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"{file} is no YAML ({str(error)[:200]}): each line is 'name: scale'.") from error
    if not isinstance(table, dict):
        raise ConfigError(f"{file} is no table: each line is 'name: scale'.")
    return list(table.items())
