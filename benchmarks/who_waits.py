"""Which of the two sides of a training run waits for the other, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchgrasp.processes import count_cores

# Share of an iteration below which a wait is not worth a remedy.
_NOTHING = 0.1


def tell_who_waits(row: Mapping[str, Any], groups: int) -> str:
    """A sentence of a row of suite=training that overlaps; an iteration asks for so many groups of worlds."""
    workers, whole = row["workers"], row["iteration_seconds"]
    learner, worker = row["learner_waits_seconds"], row["worker_waits_seconds"]
    of = f"of {whole:.1f} s an iteration"
    if max(learner, worker) < _NOTHING * whole:
        return f"neither side waits: the learner {learner:.1f} and a worker {worker:.1f} {of}."
    if learner <= worker:
        rest = f", the learner {learner:.1f}" if learner >= _NOTHING * whole else ""
        return f"a worker waits {worker:.1f} {of} for the learner{rest}; more workers bring nothing."
    return f"the learner waits {learner:.1f} {of} for rollouts; {_remedy(workers, groups)}."


def _remedy(workers: int, groups: int) -> str:
    cores = count_cores()
    if workers > groups:
        return "more groups of worlds help"
    with_groups = " with more groups of worlds" if workers == groups else ""
    where = f", on more cores than the {cores} here" if workers >= cores else ""
    return f"more workers help{with_groups}{where}"
