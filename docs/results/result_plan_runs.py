"""Making a planned table: folders first, then every run with every seed, several side by side.

What runs need of each other is kept in outputs/results/<table>/<commit>, with the logs. The commit is the
last one that changed code: a table that was stopped finds it again.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from result_history import has_same_code, run_git
from result_plans import (
    Plan,
    PlannedRun,
    find_commands,
    find_names,
    list_commands,
    record_seeds,
    seeded,
)
from result_records import RESULTS, ROOT, Record
from result_runs import (
    CODE,
    check_committed,
    environment,
    find_written,
    python_command,
    read_success,
    read_summary,
    tell_machine,
    write_record,
)
from result_tables import Table, read_planned, read_table

from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.interruption import check, hold, watch_signals

_PAUSE = 0.5  # seconds between looks at what runs


@dataclass(frozen=True)
class Task:
    """A command to be run: what fills a folder, or a run with a seed, whose record is then written.

    Attributes:
        name: of the folder or the record.
        command: with `<name>` for what it needs.
        needs: names of the tasks that have to end before.
        run: of a record, None of a folder.
        seed: of the run.
    """

    name: str
    command: str
    needs: tuple[str, ...] = ()
    run: str | None = None
    seed: int = 0


@dataclass(frozen=True)
class _Started:
    process: subprocess.Popen
    log: TextIO
    began: float


class PlanRunner:
    """Runs tasks of one table side by side.

    Args:
        table: with a plan.
        jobs: how many commands run at a time, one thread each.
        folder: of the tables.
    """

    def __init__(self, table: Table, jobs: int, folder: Path = RESULTS) -> None:
        self.table, self.jobs, self.folder = table, jobs, folder
        self.plan = read_planned(table.name, folder)[0]
        self.commit = run_git("rev-parse", "--short", "HEAD")
        code = run_git("log", "-1", "--format=%h", "--", *CODE)
        self.kept = ROOT / "outputs" / "results" / table.name / code
        self.written: list[str] = []
        self.failed: dict[str, str] = {}

    def work_off(self, tasks: Mapping[str, Task]) -> None:
        """Run every task once what it needs has ended; what fails leaves the others alone.

        The first ctrl-C or SIGTERM is passed on to what runs, which ends in good order.
        """
        waiting, running = dict(tasks), dict[str, _Started]()
        self.kept.mkdir(parents=True, exist_ok=True)
        with watch_signals(), hold():
            try:
                while waiting or running:
                    for name in self._ready(waiting, running)[: self.jobs - len(running)]:
                        running[name] = self._start(waiting.pop(name))
                    time.sleep(_PAUSE)
                    check()
                    for name in [name for name, each in running.items() if each.process.poll() is not None]:
                        self._finish(tasks[name], running.pop(name))
            finally:
                _stop(list(running.values()))

    def _ready(self, waiting: dict[str, Task], running: Mapping[str, _Started]) -> list[str]:
        """What can be started; what needs a task that failed is failed too."""
        for name, task in list(waiting.items()):
            if lost := [need for need in task.needs if need in self.failed]:
                self.failed[name] = f"needs {lost[0]}"
                del waiting[name]
        busy = waiting.keys() | running.keys()
        return [name for name, task in waiting.items() if not busy & set(task.needs)]

    def _start(self, task: Task) -> _Started:
        place = self.kept / task.name
        if task.run is not None:  # of a run that was stopped
            _origin_file(self.kept, task.name).unlink(missing_ok=True)
            shutil.rmtree(place, ignore_errors=True)
        names = find_names(task.command)
        command = task.command
        for name in names:
            command = command.replace(f"<{name}>", shlex.quote(str(self._find(name, task.seed))))
        words = [*python_command(command), f"output_dir={place if task.run else self.kept}"]
        log = (self.kept / f"{task.name}.log").open("w")
        print(f"{self.table.name}/{task.name} begins: {task.command}", flush=True)
        process = subprocess.Popen(
            words,
            cwd=ROOT,
            env={**environment(), "OMP_NUM_THREADS": "1"},
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # a terminal's ctrl-C comes to this process alone, which passes it on
        )
        return _Started(process, log, time.monotonic())

    def _find(self, name: str, seed: int) -> Path:
        """Where a folder lies, or the directory of a run with this seed that has ended."""
        if name in self.plan.folders:
            return self.kept / name
        record = f"{name}_{seed}"
        return find_written(self.kept / record, "summary.json", seeded(self.plan, name, seed)).parent

    def _finish(self, task: Task, started: _Started) -> None:
        started.log.close()
        minutes = (time.monotonic() - started.began) / 60
        try:
            if code := started.process.returncode:
                raise ConfigError(f"exit code {code}: see {started.log.name}")
            if task.run is not None:
                told = _tell_origin(self.plan, task.run, task.seed)
                _origin_file(self.kept, task.name).write_text(told)
                record = self._read(task.run, task.seed, read_summary(self.kept / task.name, task.command))
                write_record(self.table, task.name, record, self.folder)
                self.written.append(task.name)
            print(f"{self.table.name}/{task.name} ended after {minutes:.1f} minutes", flush=True)
        except TorchgraspError as error:
            self.failed[task.name] = str(error)
            print(f"{self.table.name}/{task.name} failed after {minutes:.1f} minutes: {error}", flush=True)

    def _read(self, run: str, seed: int, summary: Mapping[str, Any]) -> Record:
        return Record(
            command=seeded(self.plan, run, seed),
            commit=self.commit,
            seed=seed,
            machine=tell_machine(summary["hardware"]),
            versions=summary["versions"],
            recorded="run",
            needs=find_commands(self.plan, run, seed),
            note=f"{self.jobs} runs side by side, one thread each" if self.jobs > 1 else "",
            rows=read_rows(self.plan.runs[run], summary),
        )


def run_plan(
    name: str,
    *,
    only: Sequence[str] | None = None,
    again: bool = False,
    jobs: int = 1,
    folder: Path = RESULTS,
) -> list[str]:
    """Run what is missing of a planned table, and what it needs; returns the names of the records written.

    Records that the present code and the plan's command gave already are left as they are, unless `again`.

    Args:
        name: of the table.
        only: names of runs or of records; None: all.
        again: also those that are there.
        jobs: commands that run side by side.
        folder: of the tables.

    Raises:
        ConfigError: where code is not committed, or after the last command where some have failed.
        Interrupted: at ctrl-C or SIGTERM, once what ran has ended.
    """
    if jobs < 1:
        raise ConfigError(f"--jobs {jobs}: give 1, or the number of idle cores.")
    table, plan = read_table(name, folder), read_planned(name, folder)[0]
    chosen = choose_records(plan, only)
    check_committed()
    missing = [each for each in chosen if again or not _is_there(table, plan, each)]
    print(f"{name}: {len(chosen) - len(missing)} of {len(chosen)} records are there already", flush=True)
    runner = PlanRunner(table, jobs, folder)
    runner.work_off(list_tasks(plan, missing, runner.kept))
    if runner.failed:
        told = "; ".join(f"{each} ({why})" for each, why in runner.failed.items())
        raise ConfigError(f"These have no result: {told}. The same command tries them again.")
    return runner.written


def choose_records(plan: Plan, only: Sequence[str] | None) -> list[str]:
    """Records by the names of runs or records; ConfigError names what is neither."""
    seeds = record_seeds(plan)
    if only is None:
        return list(seeds)
    if unknown := [each for each in only if each not in seeds and each not in plan.runs]:
        raise ConfigError(f"{', '.join(unknown)} is no run: choose from {', '.join(plan.runs)}.")
    return [each for each, (run, _) in seeds.items() if each in only or run in only]


def list_tasks(plan: Plan, records: Sequence[str], kept: Path) -> dict[str, Task]:
    """The tasks that give these records, each after those that it needs.

    Folders are always among them, because a collection that is whole ends at once. A run that is needed is
    among them unless its directory is kept, of the commands that the plan has now.
    """
    tasks: dict[str, Task] = {}
    for record in records:
        run, seed = record_seeds(plan)[record]
        _add(tasks, plan, run, seed, kept, set(records))
    return tasks


def read_rows(planned: PlannedRun, summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What a summary gives to each row: success, how each scene ended, and errors of grasp prediction."""
    rows = []
    for label in planned.rows:
        name = label.get("of")
        told = summary["comparison"].get(name, {}) if name else summary
        row = read_success({"success_rate": None, **({"of": name} if name else {})}, summary)
        row |= {"outcomes": told.get("outcomes", ""), "wall_seconds": summary["wall_seconds"]}
        if predictor := label.get("predictor"):
            row["grasp_prediction"] = _predictions(summary, str(predictor))
        rows.append({key: value for key, value in row.items() if key != "of"})
    return rows


def _predictions(summary: Mapping[str, Any], predictor: str) -> Mapping[str, Any]:
    told = summary.get("grasp_prediction", {})
    if predictor not in told:
        raise ConfigError(
            f"The summary has predictions of {', '.join(told) or 'nobody'}, not of {predictor}."
        )
    return told[predictor]["expert_goal"]


def _add(tasks: dict[str, Task], plan: Plan, run: str, seed: int, kept: Path, records: set[str]) -> None:
    command, needs = seeded(plan, run, seed), []
    for name in find_names(command):
        if name in plan.folders:
            tasks.setdefault(name, Task(name, plan.folders[name]))
            needs.append(name)
        elif (record := f"{name}_{seed}") in records or not _is_kept(kept, plan, name, seed):
            _add(tasks, plan, name, seed, kept, records)
            needs.append(record)
    tasks.setdefault(f"{run}_{seed}", Task(f"{run}_{seed}", command, tuple(needs), run, seed))


def _origin_file(kept: Path, record: str) -> Path:
    """Where the commands are kept that led to a run that has ended, beside its directory."""
    return kept / f"{record}.commands"


def _tell_origin(plan: Plan, run: str, seed: int) -> str:
    return "\n".join(list_commands(plan, run, seed))


def _is_kept(kept: Path, plan: Plan, run: str, seed: int) -> bool:
    record = f"{run}_{seed}"
    file = _origin_file(kept, record)
    same = file.exists() and file.read_text() == _tell_origin(plan, run, seed)
    return same and any((kept / record).rglob("summary.json"))


def _is_there(table: Table, plan: Plan, name: str) -> bool:
    record, origin = table.records.get(name), record_seeds(plan)[name]
    if record is None or record.recorded != "run":
        return False
    same = [*record.needs, record.command] == list_commands(plan, *origin)
    return same and has_same_code(record.commit, CODE)


def _stop(running: Sequence[_Started]) -> None:
    for each in running:
        each.process.terminate()
    for each in running:
        each.process.wait()
        each.log.close()
