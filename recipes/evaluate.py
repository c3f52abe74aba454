"""Success of a policy on scenes that training never saw, with its films, failures and grasp predictions.

python recipes/evaluate.py policy=pretrained objects=ycb objects.split=test
python recipes/evaluate.py policy=outputs/td3_bc/<date_time> episodes=200 seed=1000 video.episodes=3
python recipes/evaluate.py policy=expert protocol=moving
"""

from __future__ import annotations

import time

from omegaconf import DictConfig

from torchgrasp import keys
from torchgrasp.config import (
    LEARNED_FROM,
    PREDICTED_FROM,
    describe_scenes,
    evaluation_config,
    make_policy,
    make_pool,
    make_predictors,
    make_split_env,
    observed_shapes,
    one_line_errors,
    open_run_dir,
    plain,
    predict_grasps,
    prepare_objects,
    recipe_main,
    watch_values,
    write_page,
)
from torchgrasp.data.files import try_folder
from torchgrasp.evaluation.success_rate import evaluate_policy
from torchgrasp.report import console
from torchgrasp.report.episode_pictures import FailurePictures, GraspPictures
from torchgrasp.report.film import check_video_tools
from torchgrasp.report.film_recording import record_films
from torchgrasp.runs import write_summary
from torchgrasp.sim.engines import describe_engine


def evaluate(cfg: DictConfig) -> dict:
    """Run `episodes` scenes of the evaluation's objects; write and return the summary."""
    started = time.monotonic()
    cfg = evaluation_config(cfg)
    if cfg.video.episodes:
        check_video_tools()
    observed_shapes(cfg)
    try_folder(str(cfg.output_dir))
    name, scenes = str(cfg.policy), describe_scenes(cfg)
    policy, values = watch_values(cfg, make_policy(cfg, name))
    predictors = make_predictors(cfg, name) if cfg.grasp_prediction else {}
    by = {"learner_steps": console.learner_steps} if name == "takeover" else {}
    failed, predicted = FailurePictures(), GraspPictures()
    watched = [failed.add] if values is None else [failed.add, values.watch]
    sizes = {"num_episodes": cfg.evaluation.episodes, "num_envs": cfg.evaluation.num_envs}
    keep = (*(PREDICTED_FROM if predictors else LEARNED_FROM), keys.STATE_ACTION_VALUE)
    with make_pool(cfg, keep=keep) as pool:
        prepare_objects(cfg, "test")
        table = evaluate_policy(pool, policy, **sizes, description=name, by=by, watch=watched)
        if values is not None:
            table["value_quality"] = values.summary()
        if predictors:
            table["grasp_prediction"] = predict_grasps(cfg, pool, predictors, predicted.add)
    console.print_comparison({name: table}, episodes=cfg.evaluation.episodes, scenes=scenes)
    console.print_failures(table)
    console.print_learner_steps(table)
    console.print_grasp_prediction(table)
    console.print_value_quality(table)
    run_dir = open_run_dir(cfg, "evaluate")
    if cfg.video.episodes:
        count = min(cfg.video.episodes, cfg.evaluation.episodes)
        env = make_split_env(cfg, "test")
        record_films(env, policy, run_dir / "videos", num_episodes=count, fps=cfg.video.fps)
    summary = {
        **table,
        "policy": name,
        "learner": cfg.learner,
        "protocol": cfg.protocol,
        "scenes": scenes,
        "engine": describe_engine(plain(cfg.get("engine")))["_target_"],
        "wall_seconds": time.monotonic() - started,
        "gradient_steps": 0,
    }
    summary = write_summary(run_dir, summary)
    pictures = {"Predicted grasps": predicted.pictures} if predictors else {}
    write_page(cfg, run_dir, summary, {**pictures, "Failed episodes": failed.pictures})
    print(f"Written to {run_dir}: summary.json, report.html{', videos/' if cfg.video.episodes else ''}")
    return summary


@recipe_main(config_name="evaluate")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Evaluate as configured."""
    evaluate(cfg)


if __name__ == "__main__":
    main()
