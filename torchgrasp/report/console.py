"""What the recipes print of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchgrasp import keys
from torchgrasp.errors import printable
from torchgrasp.rollouts.episode_pool import Episode

# A success table of `SuccessTable.summary`, or a row of one.
Table = Mapping[str, Any]
_BIN = 5  # steps of the learner that are counted together


def print_comparison(tables: Mapping[str, Table], *, episodes: int, scenes: str) -> None:
    """Success rates side by side, the policy's last.

    Args:
        tables: by name, the policy's first.
        episodes: that each was measured on.
        scenes: where their objects come from, in words.
    """
    print(f"\nSuccess on the same {episodes} scenes of {scenes}, 95 % interval")
    for name, table in reversed(list(tables.items())):
        print(f"  {printable(name):30s} {_rate(table)}")


def print_gains(gains: Mapping[str, Table]) -> None:
    """Differences of success rates in points, below the comparison."""
    for name, gain in gains.items():
        points, low, high = (100 * each for each in (gain["gain"], *gain["ci95"]))
        print(f"  {printable(name):30s} {points:+5.1f} points  [{low:+.1f}, {high:+.1f}]")


def print_failures(table: Table) -> None:
    """Why episodes failed, on how many objects none succeeded, and the worst objects with their causes."""
    lifted = len(table["objects"]) - len(table["never_lifted"])
    print(f"  {lifted} of the {len(table['objects'])} objects met were lifted at least once")
    for cause, count in table["failures"].items():
        print(f"  {count:4d} failed: {cause}")
    rows = worst_objects(table["objects"])
    if rows:
        print("\nThe worst objects")
    for name, row in rows.items():
        causes = "; ".join(f"{count} {cause}" for cause, count in row["failures"].items())
        print(f"  {_counts(name, row)}  {causes}")


def print_learner_steps(table: Table) -> None:
    """For policy=takeover success by the steps that the learner acted before the expert took over."""
    rows = table.get("learner_steps", {})
    if rows:
        print("\nBy the learner's steps before the expert took over")
    for name in sorted(rows, key=lambda name: int(name.split("-")[0])):
        print(f"  {_counts(name, rows[name])}")


def print_grasp_prediction(table: Table) -> None:
    """Table 5 for each network that predicts grasps: min / mean along the expert's trajectories."""
    for network, errors in table.get("grasp_prediction", {}).items():
        print(f"\nGrasp prediction of {network} along {errors['trajectories']} trajectories of the expert")
        for reading, row in errors.items():
            if isinstance(row, dict):
                cells = (row["translation_m"], row["rotation_deg"], row["point_distance_m"])
                words = [f"{cell['min']:.3f} / {cell['mean']:.3f}" for cell in cells]
                print(f"  {reading.replace('_', ' '):26s} {words[0]} m   {words[1]} deg   {words[2]} m")


def worst_objects(objects: Mapping[str, Table], at_most: int = 10) -> dict[str, Table]:
    """Those that failed at all, the lowest rate first, of equals the one tried most."""
    failed = {name: row for name, row in objects.items() if row["successes"] < row["episodes"]}
    ranked = sorted(failed, key=lambda name: (failed[name]["success_rate"], failed[name]["success_ci95"][1]))
    return {name: failed[name] for name in ranked[:at_most]}


def learner_steps(episode: Episode) -> str:
    """The bin of an episode of policy=takeover: 0-5, 6-10, 11-15, ... steps of the learner."""
    steps = int((episode.steps[keys.TURN] == 0).sum())
    last = _BIN * max(1, -(-steps // _BIN))
    return f"{last - _BIN + 1 if last > _BIN else 0}-{last}"


def _counts(name: str, row: Table) -> str:
    return f"{printable(name):30s} {row['successes']:4d} of {row['episodes']:4d}  {_rate(row)}"


def print_value_quality(table: Table) -> None:
    """What a critic's values know of the end of an episode, by the steps left."""
    quality = table.get("value_quality")
    if quality is None:
        return
    print(f"\nThe critic's values in {quality['episodes']} episodes, by steps left")
    print("  steps left  area under the curve  value of successes  of failures  error  of the rate alone")
    for left, row in quality["steps_left"].items():
        names = ("auc", "value_of_successes", "value_of_failures", "error", "error_of_rate")
        cells = ["-" if row[name] is None else f"{row[name]:.3f}" for name in names]
        print("  {:>10}  {:>20}  {:>18}  {:>11}  {:>5}  {:>17}".format(left, *cells))


def _rate(row: Table) -> str:
    low, high = (100 * bound for bound in row["success_ci95"])
    return f"{100 * row['success_rate']:5.1f} %  [{low:.1f}, {high:.1f}]"
