"""What the recipes print of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from torchgrasp import keys
from torchgrasp.report.run_page import Picture, write_report
from torchgrasp.rollouts.episode_pool import Episode

# What stands at the head of a report, where a recipe has it.
_HIGHLIGHTS = (
    *("seed", "objects._target_", "objects.num_objects", "evaluation.num_objects", "camera._target_"),
    *("env.horizon", "env.target_motion", "evaluation.target_motion", "expert._target_"),
    *("model.encoder._target_", "num_points", "pretrain.steps", "total_env_steps"),
    *("loss.bc_weight", "replay.online_fraction", "init"),
)
_BIN = 5  # steps of the learner that are counted together


def describe_scenes(cfg: DictConfig) -> str:
    """Where the objects of the evaluation come from, in words."""
    if cfg.objects.get("split") is None:
        return "the object set as a whole (it has no splits)"
    return f"the {cfg.evaluation.split} split"


def print_comparison(cfg: DictConfig, tables: dict[str, dict]) -> None:
    """Success rates side by side, the policy's last."""
    print(f"\nSuccess on the same {cfg.evaluation.episodes} scenes of {describe_scenes(cfg)}, 95 % interval")
    for name, table in reversed(tables.items()):
        print(f"  {name:30s} {_rate(table)}")


def print_failures(table: dict) -> None:
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


def print_learner_steps(table: dict) -> None:
    """For policy=takeover success by the steps that the learner acted before the expert took over."""
    rows = table.get("learner_steps", {})
    if rows:
        print("\nBy the learner's steps before the expert took over")
    for name in sorted(rows, key=lambda name: int(name.split("-")[0])):
        print(f"  {_counts(name, rows[name])}")


def print_grasp_prediction(table: dict) -> None:
    """Table 5 for each network that predicts grasps: min / mean along the expert's trajectories."""
    for network, errors in table.get("grasp_prediction", {}).items():
        print(f"\nGrasp prediction of {network} along {errors['trajectories']} trajectories of the expert")
        for reading, row in errors.items():
            if isinstance(row, dict):
                cells = (row["translation_m"], row["rotation_deg"], row["point_distance_m"])
                words = [f"{cell['min']:.3f} / {cell['mean']:.3f}" for cell in cells]
                print(f"  {reading.replace('_', ' '):26s} {words[0]} m   {words[1]} deg   {words[2]} m")


def write_page(
    cfg: DictConfig, run_dir: Path, summary: Mapping[str, Any], pictures: Mapping[str, Sequence[Picture]]
) -> None:
    """report.html of a run, headed by its recipe's name and its most telling options."""
    chosen = {_readable(name): OmegaConf.select(cfg, name) for name in _HIGHLIGHTS}
    if "total_env_steps" not in cfg:  # nothing was trained on
        chosen.pop("objects.num_objects")
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    write_report(
        run_dir,
        summary,
        title=f"{run_dir.resolve().parent.name} {run_dir.name}",
        highlights={name: _readable(value) for name, value in chosen.items() if value is not None},
        config=config,
        pictures=pictures,
    )


def _readable(value: Any) -> Any:
    """A class by its own name, an option that names a class by what the class is for."""
    text = str(value).removesuffix("._target_")
    return text.rsplit(".", 1)[-1] if text.startswith("torchgrasp.") else text


def worst_objects(objects: dict[str, dict], at_most: int = 10) -> dict[str, dict]:
    """Those that failed at all, the lowest rate first, of equals the one tried most."""
    failed = {name: row for name, row in objects.items() if row["successes"] < row["episodes"]}
    ranked = sorted(failed, key=lambda name: (failed[name]["success_rate"], failed[name]["success_ci95"][1]))
    return {name: failed[name] for name in ranked[:at_most]}


def learner_steps(episode: Episode) -> str:
    """The bin of an episode of policy=takeover: 0-5, 6-10, 11-15, ... steps of the learner."""
    steps = int((episode.steps[keys.TURN] == 0).sum())
    last = _BIN * max(1, -(-steps // _BIN))
    return f"{last - _BIN + 1 if last > _BIN else 0}-{last}"


def _counts(name: str, row: dict) -> str:
    return f"{name:30s} {row['successes']:4d} of {row['episodes']:4d}  {_rate(row)}"


def _rate(row: dict) -> str:
    low, high = (100 * bound for bound in row["success_ci95"])
    return f"{100 * row['success_rate']:5.1f} %  [{low:.1f}, {high:.1f}]"
