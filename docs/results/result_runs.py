"""Running a table's commands again: each writes its record from the run's own summary or benchmark file."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from result_history import has_same_code, run_git
from result_tables import (
    NOT_RECORDED,
    RESULTS,
    ROOT,
    Definition,
    Record,
    Table,
    read_table,
    record_path,
)

from torchgrasp.data.files import write_json_atomically
from torchgrasp.documents import read_document, read_json
from torchgrasp.errors import ConfigError
from torchgrasp.runs.summary import Summary

# What gives the figures. The record of the shipped policy's own lies in the package.
CODE = ("torchgrasp", "conf", "recipes", "benchmarks", ":!torchgrasp/weights/pretrained.json")
_SUCCESS = ("success_rate", "success_ci95", "episodes", "failures")
_REMEDY = "look at what the command printed"


def run_table(
    name: str, *, only: Sequence[str] | None = None, again: bool = False, folder: Path = RESULTS
) -> list[str]:
    """Run the commands of a table's records and write what they gave; returns the names of those run.

    Records that this version's code gave already are left as they are, unless `again`: a table that was
    stopped goes on where it was. Every record is written as soon as its command has ended.

    Raises:
        ConfigError: where the table cannot be made by its commands alone, where a command needs a run that
            the record does not name, where code is not committed, or where a command fails.
    """
    table = read_table(name, folder)
    chosen = _choose(table, only)
    check_committed()
    commit = run_git("rev-parse", "--short", "HEAD")
    done = []
    for each in chosen:
        record = table.records[each]
        if not again and record.recorded == "run" and has_same_code(record.commit, CODE):
            print(f"{name}/{each}: of this version's code already")
            continue
        print(f"{name}/{each}: {record.command}", flush=True)
        new = run_record(record, table.definition, commit)
        write_record(table, each, new, folder)
        if new.note:
            print(f"{name}/{each} keeps its note, see whether it still holds: {new.note}")
        done.append(each)
    return done


def run_record(record: Record, definition: Definition, commit: str) -> Record:
    """Run a record's command and read what it gave.

    What tells rows apart, the note and the other commands are kept from the record.
    """
    with tempfile.TemporaryDirectory(prefix="results-") as scratch:
        command = [*python_command(record.command), f"output_dir={scratch}"]
        code = subprocess.run(command, cwd=ROOT, env=environment()).returncode
        if code != 0:
            raise ConfigError(f"{record.command} ended with exit code {code}: {_REMEDY}.")
        if definition.reads == "benchmark":
            told = read_json(find_written(Path(scratch), "benchmark.json", record.command), _REMEDY)
            rows = _merge(record.rows, _benchmark_rows(told["rows"]))
        else:
            told = read_summary(Path(scratch), record.command)
            rows = [read_success(row, told) for row in record.rows]
    return Record(
        command=record.command,
        commit=commit,
        seed=record.seed,
        machine=tell_machine(told["hardware"]),
        versions=told["versions"],
        recorded="run",
        needs=record.needs,
        note=record.note,
        rows=rows,
    )


def read_success(row: Mapping[str, Any], summary: Mapping[str, Any]) -> dict[str, Any]:
    """A row with the success of a summary in place of its own; see `Definition.reads`.

    >>> old = {"scenes": "all", "policy": {"success_rate": 0.5, "episodes": 2}}
    >>> read_success(old, {"success_rate": 0.75, "success_ci95": [0.3, 0.95], "episodes": 4})
    {'scenes': 'all', 'policy': {'success_rate': 0.75, 'success_ci95': [0.3, 0.95], 'episodes': 4}}
    """
    if "success_rate" not in row:
        nested = {name: value for name, value in row.items() if isinstance(value, Mapping)}
        found = [name for name, value in nested.items() if "success_rate" in value]
        if len(found) != 1:
            raise ConfigError(f"The row {dict(row)} has no success of its own to be measured again.")
        return {**row, found[0]: read_success(row[found[0]], summary)}
    name, told = row.get("of"), summary
    if name:
        if name not in summary["comparison"]:
            raise ConfigError(f"The summary compares {', '.join(summary['comparison'])}, not {name}.")
        told = summary["comparison"][name]
    kept = {name: value for name, value in row.items() if name not in _SUCCESS}
    return kept | {name: told[name] for name in _SUCCESS if name in told}


def read_summary(folder: Path, command: str) -> dict[str, Any]:
    """The one summary.json below a folder that a command wrote; ConfigError where there is not one."""
    return read_document(find_written(folder, "summary.json", command), Summary, _REMEDY).model_dump()


def find_written(folder: Path, name: str, command: str) -> Path:
    """The one file of this name below a folder that a command wrote; ConfigError where there is not one."""
    found = sorted(folder.rglob(name))
    if len(found) != 1:
        raise ConfigError(f"{command} wrote {len(found)} {name} instead of one: {_REMEDY}.")
    return found[0]


def tell_machine(hardware: Mapping[str, Any]) -> str:
    """The machine of a summary in words.

    >>> tell_machine({"processor": "AMD EPYC", "cores": 2, "accelerators": []})
    '2 cores of AMD EPYC, no GPU'
    """
    accelerators = hardware["accelerators"]
    return f"{hardware['cores']} cores of {hardware['processor']}, {', '.join(accelerators) or 'no GPU'}"


def _choose(table: Table, only: Sequence[str] | None) -> list[str]:
    chosen = list(table.records) if only is None else list(only)
    if unknown := [each for each in chosen if each not in table.records]:
        raise ConfigError(f"{table.name} has no record {', '.join(unknown)}: {', '.join(table.records)}.")
    if table.definition.reads is None:
        commands = "\n".join(dict.fromkeys(record.command for record in table.records.values()))
        raise ConfigError(f"{table.name} is not made by its commands alone; these gave it:\n{commands}")
    for each in chosen:
        python_command(table.records[each].command)
    return chosen


def python_command(command: str) -> list[str]:
    """A recipe's or benchmark's command with this Python; nothing else is run, and no shell reads it."""
    words = [] if command == NOT_RECORDED else shlex.split(command)
    script = words[1] if len(words) > 1 else ""
    scripts = [*ROOT.glob("recipes/*.py"), ROOT / "benchmarks" / "benchmark.py"]
    ours = {path.relative_to(ROOT).as_posix() for path in scripts}
    if words[:1] != ["python"] or script not in ours:
        raise ConfigError(f"{command!r} is no command of a recipe or a benchmark: run it by hand.")
    if "<" in command:
        raise ConfigError(f"{command} needs a run or folder of yours: put its path there, or run it by hand.")
    return [sys.executable, *words[1:]]


def environment() -> dict[str, str]:
    """Of a command: it imports this checkout."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def _benchmark_rows(rows: Any) -> list[dict[str, Any]]:
    """A list of rows with names, also of a suite that gives them by name."""
    return [{"name": name, **row} for name, row in rows.items()] if isinstance(rows, Mapping) else rows


def _merge(old: Sequence[Mapping[str, Any]], new: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """New rows, with the label that a row of the same name had."""
    labels = {row.get("name"): {"label": row["label"]} for row in old if "label" in row}
    return [labels.get(row.get("name"), {}) | dict(row) for row in new]


def write_record(table: Table, name: str, record: Record, folder: Path) -> None:
    """Write a record where its table keeps it."""
    written = record.model_dump(exclude_defaults=True)
    if table.definition.source is None:
        write_json_atomically(record_path(table.name, name, folder), written)
        return
    path = ROOT / table.definition.source
    whole = json.loads(path.read_text())
    whole["results"][name] = written
    write_json_atomically(path, whole)


def check_committed() -> None:
    """ConfigError where code is not committed: results belong to a commit."""
    if changed := run_git("status", "--porcelain", "--", *CODE):
        raise ConfigError(f"Results belong to a commit: commit these first, or undo them: {changed}")
