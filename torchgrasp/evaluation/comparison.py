"""Groups of runs side by side: means over seeds, pooled success, differences to the first group."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.intervals import (
    Interval,
    mean_interval,
    newcombe_interval,
    welch_interval,
    wilson_interval,
)
from torchgrasp.evaluation.run_results import RunResult, check_same_scenes


@dataclass(frozen=True)
class Difference:
    """A group's mean minus the first group's.

    Attributes:
        value: the difference of the means.
        over_seeds: 95 % interval over seeds, None where a group has a single run.
        method: `paired` by seed, where both groups have the same seeds, else `welch`; None without interval.
        over_episodes: Newcombe's 95 % interval of the pooled success rates, None of other measures.
    """

    value: float
    over_seeds: Interval | None
    method: str | None
    over_episodes: Interval | None


@dataclass(frozen=True)
class GroupRow:
    """One measure of one group.

    Attributes:
        label: of the group.
        measure: `success rate`, or the name of another number of the summary.
        runs: the group's runs, by seed.
        values: the measure of each of them.
        success: (successes, episodes) of all runs together, None of other measures.
        difference: to the first group; None of the first.
    """

    label: str
    measure: str
    runs: tuple[RunResult, ...]
    values: tuple[float, ...]
    success: tuple[int, int] | None
    difference: Difference | None

    @property
    def mean(self) -> float:
        """Mean over the runs."""
        return float(np.mean(self.values))

    @property
    def std(self) -> float:
        """Sample standard deviation over the runs (divisor R - 1), NaN for one."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else float("nan")

    @property
    def seeds(self) -> tuple[int | None, ...]:
        """Seed of each run."""
        return tuple(run.seed for run in self.runs)

    @property
    def pooled(self) -> tuple[float, float, float] | None:
        """Success rate of all runs' episodes together, and the ends of its 95 % Wilson interval."""
        if self.success is None:
            return None
        successes, episodes = self.success
        return successes / episodes if episodes else 0.0, *wilson_interval(successes, episodes)


def compare_runs(groups: Mapping[str, Sequence[RunResult]]) -> list[GroupRow]:
    """A row for each measure of each group, groups in the order given, each beside the first.

    Raises:
        ConfigError: where a group is empty or has a seed twice, or runs have different scenes or measures.

    Example:
        >>> from pathlib import Path
        >>> def run(seed, successes):
        ...     values = {"success rate": successes / 100}
        ...     return RunResult(Path(f"{seed}"), seed, values, (successes, 100), {}, 5.0, 1000, 200)
        >>> rows = compare_runs({"without": [run(0, 40), run(1, 50)], "with": [run(0, 62), run(1, 70)]})
        >>> round(rows[1].mean, 2), round(rows[1].difference.value, 2), rows[1].difference.method
        (0.66, 0.21, 'paired')
    """
    for label, runs in groups.items():
        _check_group(label, runs)
    everything = [run for runs in groups.values() for run in runs]
    check_same_scenes(everything)
    _check_same_measures(everything)
    ordered = {label: tuple(sorted(runs, key=_order)) for label, runs in groups.items()}
    first = next(iter(ordered.values()))
    return [
        _row(label, measure, runs, None if runs is first else first)
        for measure in everything[0].values
        for label, runs in ordered.items()
    ]


def by_measure(rows: Sequence[GroupRow]) -> Iterator[tuple[str, list[GroupRow]]]:
    """Each measure with its groups' rows."""
    for measure in dict.fromkeys(row.measure for row in rows):
        yield measure, [row for row in rows if row.measure == measure]


def _row(
    label: str, measure: str, runs: tuple[RunResult, ...], first: tuple[RunResult, ...] | None
) -> GroupRow:
    difference = None if first is None else _difference(measure, runs, first)
    return GroupRow(label, measure, runs, _values(measure, runs), _pool(runs), difference)


def _difference(measure: str, runs: tuple[RunResult, ...], first: tuple[RunResult, ...]) -> Difference:
    values, base = _values(measure, runs), _values(measure, first)
    pooled, other = _pool(runs), _pool(first)
    episodes = newcombe_interval(*pooled, *other) if pooled is not None and other is not None else None
    value = float(np.mean(values) - np.mean(base))
    if len(values) < 2 or len(base) < 2:
        return Difference(value, None, None, episodes)
    seeds = [run.seed for run in runs]
    if None not in seeds and seeds == [run.seed for run in first]:
        pairs = [ours - theirs for ours, theirs in zip(values, base, strict=True)]
        return Difference(value, mean_interval(pairs), "paired", episodes)
    return Difference(value, welch_interval(values, base), "welch", episodes)


def _values(measure: str, runs: Sequence[RunResult]) -> tuple[float, ...]:
    return tuple(run.values[measure] for run in runs)


def _pool(runs: Sequence[RunResult]) -> tuple[int, int] | None:
    counts = [run.success for run in runs if run.success is not None]
    if len(counts) < len(runs):
        return None
    return sum(successes for successes, _ in counts), sum(episodes for _, episodes in counts)


def _check_group(label: str, runs: Sequence[RunResult]) -> None:
    if not runs:
        raise ConfigError(f"{label}: no run has finished: wait for one, or leave the label out.")
    seen: dict[int, RunResult] = {}
    for run in runs:
        if run.seed is not None and run.seed in seen:
            raise ConfigError(
                f"{label}: {seen[run.seed].run} and {run.run} have the same seed {run.seed}, and say nothing "
                "of the spread: leave one out, or give them labels of their own."
            )
        if run.seed is not None:
            seen[run.seed] = run


def _check_same_measures(runs: Sequence[RunResult]) -> None:
    for run in runs[1:]:
        if run.values.keys() != runs[0].values.keys():
            names = ", ".join(sorted(run.values.keys() ^ runs[0].values.keys()))
            raise ConfigError(f"Not both {runs[0].run} and {run.run} have {names}: compare runs alike.")


def _order(run: RunResult) -> tuple:
    return run.seed is None, run.seed or 0, str(run.run)
