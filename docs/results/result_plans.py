"""Tables of runs over seeds: what is run is declared once, each run and seed gives a record.

A row of such a table gathers the records of a run's seeds: every value is a list, in the order of the seeds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field, model_validator
from result_records import Record, Words

from torchgrasp.documents import Count, Document, Name, Plain
from torchgrasp.errors import ConfigError


class PlannedRun(Document):
    """One command that is run with every seed.

    Attributes:
        command: without seed and output_dir. `<name>` stands for a folder of the plan, or for the directory
            of an earlier run of it with the same seed.
        decides: what the run is for.
        rows: labels of the rows that its summary gives, in order. `of` names the table of the summary's
            `comparison` that a row is of, `predictor` the network whose errors of grasp prediction it has.
    """

    command: Words
    decides: Name
    rows: Annotated[list[Plain], Field(min_length=1)]


class Plan(Document):
    """What `python docs/results run` makes a table of.

    Attributes:
        seeds: of every run.
        runs: by name, in the order of the table.
        folders: by name, the command that fills each; `<name>` in it stands for the folder itself.
    """

    seeds: Annotated[list[Count], Field(min_length=1)]
    runs: Annotated[dict[Name, PlannedRun], Field(min_length=1)]
    folders: dict[Name, Words] = Field({})

    @model_validator(mode="after")
    def _check_names(self) -> Plan:
        if both := self.folders.keys() & self.runs.keys():
            raise ValueError(f"{', '.join(sorted(both))} names a folder and a run")
        known = set(self.folders)
        for run, planned in self.runs.items():
            if unknown := [name for name in find_names(planned.command) if name not in known]:
                raise ValueError(f"{run} needs <{unknown[0]}>, which is no folder and no run before it")
            known.add(run)
        for name, command in self.folders.items():
            if find_names(command) != [name]:
                raise ValueError(f"the command of the folder {name} has to name <{name}>, and no other")
        return self


def find_names(command: str) -> list[str]:
    """What a command needs: the names that stand in it as `<name>`, each once.

    >>> find_names("python recipes/bc.py init=<full> demonstrations.path=<demos>")
    ['full', 'demos']
    """
    return list(dict.fromkeys(re.findall(r"<(\w+)>", command)))


def find_commands(plan: Plan, name: str, seed: int) -> list[str]:
    """The commands that a run with this seed needs before it, of folders and runs, in order."""
    needed: list[str] = []
    for other in find_names(plan.runs[name].command):
        if other in plan.folders:
            needed.append(plan.folders[other])
        else:
            needed += list_commands(plan, other, seed)
    return list(dict.fromkeys(needed))


def list_commands(plan: Plan, run: str, seed: int) -> list[str]:
    """All commands that lead to a run with this seed, in order; the last one is its own."""
    return [*find_commands(plan, run, seed), seeded(plan, run, seed)]


def seeded(plan: Plan, run: str, seed: int) -> str:
    """The command of a run with this seed."""
    return f"{plan.runs[run].command} seed={seed}"


def record_seeds(plan: Plan) -> dict[str, tuple[str, int]]:
    """The run and the seed of each record by its name, in order: run `dagger` has `dagger_0` and so on."""
    return {f"{run}_{seed}": (run, seed) for run in plan.runs for seed in plan.seeds}


def records_of(plan: Plan, run: str, records: Mapping[str, Record]) -> dict[int, Record]:
    """The records of a run that are there, by seed; those of a page only where nothing was run since."""
    found = {seed: records.get(f"{run}_{seed}") for seed in plan.seeds}
    there = {seed: record for seed, record in found.items() if record is not None}
    measured = {seed: record for seed, record in there.items() if record.recorded == "run"}
    return measured or there


def planned_rows(plan: Plan, records: Mapping[str, Record]) -> list[dict[str, Any]]:
    """A row for each row of each run, also of those without a record."""
    return [row for run in plan.runs for row in _rows_of(plan, run, records)]


def planned_row(plan: Plan, place: str, records: Mapping[str, Record]) -> dict[str, Any]:
    """The row of "run", of "run#1" its second; ConfigError where there is none."""
    run, _, index = place.partition("#")
    rows = list(_rows_of(plan, run, records)) if run in plan.runs else []
    if (number := int(index or 0)) >= len(rows):
        raise ConfigError(f"{place} is no row of a run: choose from {', '.join(plan.runs)}.")
    return rows[number]


def _rows_of(plan: Plan, run: str, records: Mapping[str, Record]) -> Iterator[dict[str, Any]]:
    """Labels of each row with the values of its seeds, `seeds` themselves and the `version`."""
    chosen = records_of(plan, run, records)
    for number, label in enumerate(plan.runs[run].rows):
        there = {seed: each for seed, each in chosen.items() if number < len(each.rows)}
        if not there:
            yield dict(label)
            continue
        versions = dict.fromkeys(each.versions.get("torchgrasp", "unknown") for each in there.values())
        values = gather([each.rows[number] for each in there.values()])
        yield {**values, **label, "seeds": list(there), "version": ", ".join(versions)}


def gather(values: list[Any]) -> Any:
    """Several mappings as one, whose values are lists; names that not all of them have are left out.

    >>> gather([{"rate": 0.5, "error": {"mean": 2.0}}, {"rate": 0.75, "error": {"mean": 4.0}}])
    {'rate': [0.5, 0.75], 'error': {'mean': [2.0, 4.0]}}
    """
    if not all(isinstance(each, Mapping) for each in values):
        return values
    names = [name for name in values[0] if all(name in each for each in values)]
    return {name: gather([each[name] for each in values]) for name in names}
