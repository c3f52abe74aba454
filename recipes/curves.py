"""Learning curves: mean and spread over runs that differ in their seed (Fig. 7).

python recipes/curves.py 'runs=outputs/td3_bc/*' metric=train/success_rate
python recipes/curves.py 'runs={with DAgger: "dagger/td3_bc/*", without: "plain/td3_bc/*"}' x=step
"""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from torchgrasp.config import Curves, check_values, one_line_errors, open_run_dir, plain, recipe_main
from torchgrasp.data.files import write_bytes_atomically, write_text_atomically
from torchgrasp.evaluation.learning_curves import (
    LearningCurve,
    average_curves,
    read_curve,
    write_curves_csv,
)
from torchgrasp.evaluation.run_groups import find_groups
from torchgrasp.report.plots import can_plot, plot_curves, to_png, to_svg


def draw(cfg: DictConfig) -> dict[str, LearningCurve]:
    """Average each group of runs; write curves.csv and, where matplotlib is there, curves.svg and .png."""
    check_values(cfg, Curves)
    groups = find_groups(plain(cfg.runs), label=str(cfg.metric), holding="metrics.csv")
    curves = {label: _average(cfg, group) for label, group in groups.items()}
    folder = open_run_dir(cfg, "curves")
    write_curves_csv(folder / "curves.csv", curves, x=cfg.x)
    written = ["curves.csv"]
    if can_plot():
        figure = plot_curves(curves, x=cfg.x, y=cfg.metric)
        write_text_atomically(folder / "curves.svg", to_svg(figure))
        write_bytes_atomically(folder / "curves.png", to_png(figure))
        written += ["curves.svg", "curves.png"]
    else:
        print('No pictures: they need the extra viz, pip install "torchgrasp[viz]".')
    for label, curve in curves.items():
        print(f"  {label:30s} {_end(curve)} of {curve.runs} runs at {cfg.x}={curve.x[-1]:g}")
    print(f"Written to {folder}: {', '.join(written)}")
    return curves


def _average(cfg: DictConfig, runs: list[Path]) -> LearningCurve:
    return average_curves([read_curve(run, cfg.metric, x=cfg.x) for run in runs])


def _end(curve: LearningCurve) -> str:
    spread = f" ± {curve.std[-1]:.4g}" if curve.runs > 1 else ""
    return f"{curve.mean[-1]:.4g}{spread}"


@recipe_main(config_name="curves")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Draw as configured."""
    draw(cfg)


if __name__ == "__main__":
    main()
