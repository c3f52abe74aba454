"""What a finished run measured, read from its summary.json and config.yaml, and on which scenes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from torchgrasp.documents import (
    Count,
    Name,
    OpenDocument,
    Rate,
    check_document,
    read_document,
    read_yaml,
)
from torchgrasp.errors import ConfigError
from torchgrasp.runs.summary import ObjectRow, Summary
from torchgrasp.sim.engines import describe_engine

# Of the environment and the objects, what does not change a scene: scenes come from the evaluation's worlds
# and seed, the number of grasps is the expert's.
_NOT_OF_SCENES = ("env.num_envs", "env.action_space", "objects.num_grasps")
_OF_EVALUATION = ("seed", "episodes", "num_envs")
_NO_TABLES = ("objects", "comparison", "versions", "hardware", "failures", "never_lifted", "demonstrations")
_REMEDY = "restore it from a copy, or give other run directories of the recipes"


class RunConfig(OpenDocument):
    """What of a run's config.yaml is compared with other runs'; sections may be absent."""

    __pydantic_extra__: dict[str, Any] = Field(init=False)
    seed: Count | None = None
    evaluation: dict[str, Any] = Field({})
    objects: dict[str, Any] = Field({})
    env: dict[str, Any] = Field({})
    engine: dict[str, Any] | None = None


class _Objects(OpenDocument):
    objects: dict[Name, ObjectRow] = Field({})


class _Success(OpenDocument):
    success_rate: Rate
    episodes: Count


@dataclass(frozen=True)
class RunResult:
    """One run's numbers.

    Attributes:
        run: its directory.
        seed: that training began from; None of an evaluation whose run is no longer there.
        values: by measure; of a success table `success rate`, in [0, 1].
        success: (successes, episodes), None where the measures are no success.
        scenes: what fixes the evaluation's scenes, by option, and every object's episodes.
        wall_minutes: of the whole run.
        env_steps: of training, or of the evaluation.
        gradient_steps: of training.
    """

    run: Path
    seed: int | None
    values: Mapping[str, float]
    success: tuple[int, int] | None
    scenes: Mapping[str, Any]
    wall_minutes: float
    env_steps: int
    gradient_steps: int


def read_result(run_dir: str | Path, *, key: str | None = None) -> RunResult:
    """Read a run directory of td3_bc.py, evaluate.py or another recipe that evaluates.

    Args:
        run_dir: with summary.json and config.yaml.
        key: a table of the summary's `comparison`, such as "policy after imitation alone", or another
            part of the summary, such as "grasp_prediction". None: the summary's own success.

    Raises:
        CheckpointError: where a file is missing or damaged.
        ConfigError: where there is no such table, or a number of it is not finite.
    """
    run_dir = Path(run_dir)
    summary = read_document(run_dir / "summary.json", Summary, _REMEDY)
    config = _read_config(run_dir / "config.yaml")
    table = _choose(run_dir, summary.model_dump(), key)
    values, success = _measures(table, run_dir)
    result = RunResult(
        run=run_dir,
        seed=_seed(config),
        values=values,
        success=success,
        scenes=read_scenes(config) | _episodes_by_object(table, run_dir),
        wall_minutes=summary.wall_seconds / 60,
        env_steps=summary.env_steps,
        gradient_steps=summary.gradient_steps,
    )
    _check_finite(result)
    return result


def read_scenes(config: Mapping[str, Any]) -> dict[str, Any]:
    """What of a run's configuration fixes the scenes of its evaluation, by dotted name.

    >>> config = {"evaluation": {"seed": 1000}, "objects": {"split": "train", "num_objects": 160}}
    >>> read_scenes(config | {"env": {"horizon": 30, "num_envs": 7}})
    {'evaluation.seed': 1000, 'objects.split': 'train', 'objects.num_objects': 160, 'env.horizon': 30}
    """
    evaluation, objects = config.get("evaluation", {}), dict(config.get("objects", {}))
    if objects.get("split") is not None:  # the evaluation's split and number hold, where there are splits
        objects |= {name: evaluation[name] for name in ("split", "num_objects") if name in evaluation}
    chosen = {name: evaluation[name] for name in _OF_EVALUATION if name in evaluation}
    env = dict(config.get("env", {}))
    if evaluation.get("target_motion") is not None:  # of the evaluation's targets alone
        env["target_motion"] = evaluation["target_motion"]
    parts = {"evaluation": chosen, "objects": objects, "env": env}
    engine = describe_engine(config.get("engine"))
    if engine != describe_engine(None):
        parts["engine"] = engine
    return {name: value for name, value in flatten(parts) if name not in _NOT_OF_SCENES}


def check_same_scenes(results: Sequence[RunResult]) -> None:
    """Refuse runs whose evaluations met other scenes than the first one's.

    Raises:
        ConfigError: names the two runs and what differs.
    """
    first = results[0]
    for other in results[1:]:
        names = {**first.scenes, **other.scenes}
        differing = [n for n in names if first.scenes.get(n, "-") != other.scenes.get(n, "-")]
        if differing:
            words = "; ".join(
                f"{n}={first.scenes.get(n, '-')} and {other.scenes.get(n, '-')}" for n in differing[:5]
            )
            raise ConfigError(
                f"{first.run} and {other.run} were evaluated on different scenes ({words}): evaluate both "
                "alike and compare those runs."
            )


def _read_config(path: Path) -> dict[str, Any]:
    return check_document(read_yaml(path, _REMEDY), RunConfig, path, _REMEDY).model_dump(exclude_unset=True)


def _choose(run_dir: Path, summary: dict[str, Any], key: str | None) -> Mapping[str, Any]:
    if key is None:
        return summary
    tables = {name: each for name, each in summary.items() if isinstance(each, dict) and each}
    tables = {name: each for name, each in tables.items() if name not in _NO_TABLES}
    tables |= summary["comparison"]
    if key not in tables:
        raise ConfigError(
            f"key={key}: {run_dir}/summary.json has no such table: choose from {', '.join(tables) or 'none'}."
        )
    return tables[key]


def _measures(table: Mapping[str, Any], run_dir: Path) -> tuple[dict[str, float], tuple[int, int] | None]:
    if "success_rate" in table:
        told = check_document(table, _Success, run_dir / "summary.json", _REMEDY)
        return {"success rate": told.success_rate}, (round(told.success_rate * told.episodes), told.episodes)
    numbers = {name.replace(".", " "): value for name, value in flatten(table)}
    measures = {n: _to_float(v) for n, v in numbers.items() if type(v) in (int, float)}
    return {n.replace("_", " "): v for n, v in measures.items() if not n.endswith("trajectories")}, None


def _to_float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _check_finite(result: RunResult) -> None:
    bad = [name for name, value in result.values.items() if not math.isfinite(value)]
    if bad or not result.values:
        reason = f"{', '.join(bad) or 'the table'} holds no number"
        raise ConfigError(f"{result.run}: {reason}: leave the run out.")


def _episodes_by_object(table: Mapping[str, Any], run_dir: Path) -> dict[str, int]:
    rows = check_document(table, _Objects, run_dir / "summary.json", _REMEDY).objects
    return {f"episodes of {name}": row.episodes for name, row in sorted(rows.items())}


def _seed(config: Mapping[str, Any]) -> int | None:
    """The seed of the training, which an evaluation finds in the run that it evaluated."""
    if "policy" not in config:
        return config.get("seed")
    for name in ("learner", "policy"):
        trained = Path(str(config.get(name))) / "config.yaml"
        with suppress(OSError):  # a name too long for a file
            if trained.is_file():
                return _read_config(trained).get("seed")
    return None


def flatten(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted name, value) of a nested mapping's leaves; an empty mapping is a leaf.

    >>> list(flatten({"env": {"horizon": 30, "start": {}}, "seed": 0}))
    [('env.horizon', 30), ('env.start', {}), ('seed', 0)]
    """
    for key, item in value.items():
        if isinstance(item, Mapping) and item:
            yield from flatten(item, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", item
