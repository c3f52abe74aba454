"""The end of a training run: what its policy does, beside what was measured before and the baselines."""

from __future__ import annotations

from torchgrasp.config.grasp_prediction import predict_grasps
from torchgrasp.config.policies import make_policy
from torchgrasp.config.report_page import describe_scenes, write_page
from torchgrasp.config.run import Run
from torchgrasp.evaluation.grasp_prediction import find_predictors
from torchgrasp.evaluation.success import find_gain
from torchgrasp.interruption import release
from torchgrasp.report.console import print_comparison, print_gains, print_grasp_prediction
from torchgrasp.report.episode_pictures import FailurePictures, GraspPictures
from torchgrasp.runs import write_summary


@release()  # the run is saved: what is measured and written here, a resumed one makes anew
def conclude(run: Run, *, phase: str) -> dict:
    """Measure the policy and the baselines on the same scenes; write and print the summary, and return it.

    Args:
        run: that has ended.
        phase: what the main phase is called, of which the summary tells what it added (`gains`).
    """
    cfg, learner = run.cfg, run.learner
    failed, predicted = FailurePictures(), GraspPictures()
    tables = {"policy": run.evaluate(learner.policy, "policy", watch=[failed.add])}
    earlier = run.find_comparable()
    tables |= earlier
    for name in cfg.evaluation.baselines:
        tables[name] = run.evaluate(make_policy(cfg, name), name)
    run.log.log(run.gradient_steps + 1, {"test/success_rate": tables["policy"]["success_rate"]})
    scenes = describe_scenes(cfg)
    gains = {f"added by {phase}": find_gain(tables["policy"], before) for before in earlier.values()}
    summary = {**tables["policy"], "scenes": scenes, "comparison": tables, "gains": gains}
    summary |= run.describe()
    pictures = {"Failed episodes": failed.pictures}
    if cfg.evaluation.grasp_prediction:
        predictors = find_predictors(learner.networks)
        summary["grasp_prediction"] = predict_grasps(cfg, run.pool, predictors, predicted.add)
        pictures = {"Predicted grasps": predicted.pictures, **pictures}
    summary = write_summary(run.folder, summary)
    write_page(cfg, run.folder, summary, pictures)
    print_comparison(tables, episodes=cfg.evaluation.episodes, scenes=scenes)
    print_gains(gains)
    print_grasp_prediction(summary)
    print(f"{run.wall_seconds / 60:.1f} minutes. In {run.folder}: report.html and what it was made of")
    return summary
