"""The end of a run: the policy beside what was measured before and the baselines, on the same scenes."""

import json

from torchgrasp.config import Run, conclude, gather_sources, make_imitation_learner
from torchgrasp.runs import seed_everything


def test_the_summary_has_all_tables_and_what_the_run_was(composed, demonstrations, capsys):
    given = ["total_env_steps=0", "pretrain.steps=2", f"demonstrations.path={demonstrations}"]
    cfg = composed("experiment=smoke", *given, "evaluation.baselines=[random]", recipe="bc")
    seed_everything(0)
    with Run(cfg, make_imitation_learner(cfg)) as run:
        run.begin(gather_sources(cfg, run.pool, run.folder))
        for batch in run.pretraining():
            run.learner.imitate(batch)
        run.measure_once("policy after imitation alone")
        summary = conclude(run, phase="DAgger")
    assert list(summary["comparison"]) == ["policy", "policy after imitation alone", "random"]
    # Nothing was learned in between.
    tables = summary["comparison"]
    assert tables["policy"] == tables["policy after imitation alone"]
    assert list(summary["gains"]) == ["added by DAgger"]
    assert summary["gains"]["added by DAgger"]["gain"] == 0.0
    assert summary["success_rate"] == tables["policy"]["success_rate"] and summary["episodes"] == 4
    assert (summary["gradient_steps"], summary["env_steps"]) == (2, 0)
    assert summary["demonstrations"]["kind"] == "perturbed" and summary["scenes"] == "the test split"
    assert json.loads((run.folder / "summary.json").read_text())["comparison"] == tables
    assert "<th>random</th>" in (run.folder / "report.html").read_text()
    out = capsys.readouterr().out
    assert "Success on the same 4 scenes of the test split" in out and "added by DAgger" in out
