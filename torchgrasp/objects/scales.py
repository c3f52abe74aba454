"""Tables of scales: one factor to metres a named object, as a CSV or YAML file."""

from __future__ import annotations

import csv
from collections.abc import Collection
from pathlib import Path
from typing import Any

import yaml

from torchgrasp.errors import ConfigError


def read_scales(path: str | Path, names: Collection[str]) -> dict[str, float]:
    """The factors of a table, which may name only some of the objects.

    Args:
        path: ``name,scale`` lines in a .csv file (a first line ``name,scale`` is a heading), or
            ``name: scale`` in a .yaml file.
        names: those that the table may hold.
    """
    file = Path(path).expanduser()
    rows = _rows(file)
    scales: dict[str, float] = {}
    for name, value in rows:
        if name not in names:
            known = ", ".join(list(names)[:20])
            raise ConfigError(f"{file} has {name!r}, which is no object of the folder: it holds {known}.")
        if name in scales:
            raise ConfigError(f"{file} has {name!r} twice: leave one out.")
        try:
            scales[name] = float(value)
        except (TypeError, ValueError):
            scales[name] = float("nan")
        if isinstance(value, bool) or not 0.0 < scales[name] < float("inf"):
            raise ConfigError(f"{file} scales {name} by {value!r}: give a positive factor to metres.")
    return scales


def _rows(file: Path) -> list[tuple[str, Any]]:
    try:
        text = file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"scale_table={file} cannot be read ({error}): give a CSV or YAML file.") from error
    if file.suffix.lower() in (".yaml", ".yml"):
        return _yaml_rows(file, text)
    if file.suffix.lower() != ".csv":
        raise ConfigError(f"scale_table={file}: give a file that ends in .csv, .yaml or .yml.")
    rows = [[word.strip() for word in row] for row in csv.reader(text.splitlines()) if any(row)]
    if rows and rows[0] == ["name", "scale"]:
        del rows[0]
    for row in rows:
        if len(row) != 2:
            raise ConfigError(f"{file} has the line {','.join(row)!r}: each is 'name,scale'.")
    return [(name, value) for name, value in rows]


def _yaml_rows(file: Path, text: str) -> list[tuple[str, Any]]:
    try:
        table = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{file} is no YAML ({error}): each line is 'name: scale'.") from error
    if not isinstance(table, dict):
        raise ConfigError(f"{file} is no table: each line is 'name: scale'.")
    return [(str(name), value) for name, value in table.items()]
