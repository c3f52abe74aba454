"""Success of a policy: recipes/evaluate.py policy=outputs/td3_bc/<date_time> episodes=200 seed=1000."""

from __future__ import annotations

import sys
import time

import albums
import common
import hydra
import policies
import predictions
import reports
import settings
from omegaconf import DictConfig

from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.report.film import check_video_tools
from torchgrasp.runs.run_directory import write_summary


def evaluate(cfg: DictConfig) -> dict:
    """Run `episodes` scenes of the evaluation's objects; write and return the summary."""
    started = time.monotonic()
    cfg = settings.for_evaluation(cfg)
    if cfg.video.episodes:
        check_video_tools()
    common.observed_shapes(cfg)
    name = str(cfg.policy)
    policy = policies.make_policy(cfg, name)
    predictors = predictions.make_predictors(name) if cfg.grasp_prediction else {}
    by = {"learner_steps": reports.learner_steps} if name == "takeover" else {}
    failed, predicted = albums.FailureAlbum(), albums.GraspAlbum()
    keep = predictions.KEPT if predictors else common.KEPT
    with common.make_pool(cfg, keep=keep) as pool:
        common.prepare_objects(cfg, "test")
        table = common.evaluate(cfg, pool, policy, name, by=by, watch=failed.add)
        if predictors:
            table["grasp_prediction"] = predictions.measure(cfg, pool, predictors, predicted)
    run_dir = settings.open_run(cfg, "evaluate")
    if cfg.video.episodes:
        common.record_videos(cfg, policy, run_dir / "videos")
    summary = {
        **table,
        "policy": name,
        "learner": cfg.learner,
        "protocol": cfg.protocol,
        "scenes": reports.describe_scenes(cfg),
        "wall_seconds": time.monotonic() - started,
        "gradient_steps": 0,
    }
    summary = write_summary(run_dir, summary)
    pictures = {"Predicted grasps": predicted.pictures} if predictors else {}
    reports.write_page(cfg, run_dir, summary, {**pictures, "Failed episodes": failed.pictures})
    reports.print_comparison(cfg, {name: table})
    reports.print_failures(table)
    reports.print_learner_steps(table)
    reports.print_grasp_prediction(table)
    print(f"Written to {run_dir}: summary.json, report.html{', videos/' if cfg.video.episodes else ''}")
    return summary


@hydra.main(version_base=None, config_path="../conf", config_name="evaluate")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Evaluate as configured."""
    evaluate(cfg)


if __name__ == "__main__":
    sys.argv = settings.expand_video(sys.argv)
    main()
