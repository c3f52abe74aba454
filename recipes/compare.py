"""Runs side by side: means over seeds, pooled success, differences with their intervals.

python recipes/compare.py 'runs={with DAgger: "dagger/td3_bc/*", without: [DIR, DIR]}'
python recipes/compare.py runs=outputs/sweeps/<date_time>
"""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from torchgrasp.config import Comparison, check_values, one_line_errors, open_run_dir, plain, recipe_main
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.comparison import GroupRow, compare_runs
from torchgrasp.evaluation.run_groups import find_groups
from torchgrasp.evaluation.run_results import RunResult, read_result
from torchgrasp.report.comparison_page import to_text, write_comparison
from torchgrasp.runs.sweep_record import read_failure


def compare(cfg: DictConfig) -> list[GroupRow]:
    """Compare the runs' summaries; print the tables, write compare.md, compare.csv and compare.html."""
    check_values(cfg, Comparison)
    groups = find_groups(plain(cfg.runs), label="all runs", holding="config.yaml")
    rows = compare_runs({label: _read(runs, cfg.key) for label, runs in groups.items()})
    folder = open_run_dir(cfg, "compare")
    written = write_comparison(folder, rows, title=cfg.title or _title(groups, cfg.key))
    print(to_text(rows))
    print(f"Written to {folder}: {', '.join(path.name for path in written)}")
    return rows


def _read(runs: list[Path], key: str | None) -> list[RunResult]:
    """The finished runs' results; unfinished ones are named, failed ones refused."""
    results = []
    for run in runs:
        if (failure := read_failure(run)) is not None:
            raise ConfigError(
                f"{run} failed: {failure} Go on with resume={run}, or name the others alone: a mean "
                "without the runs that failed may flatter."
            )
        if (run / "summary.json").is_file():
            results.append(read_result(run, key=key))
        else:
            print(f"Left out: {run} has no summary.json: it has not finished.")
    return results


def _title(groups: dict[str, list[Path]], key: str | None) -> str:
    return " / ".join(groups) + ("" if key is None else f": {key}")


@recipe_main(config_name="compare")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Compare as configured."""
    compare(cfg)


if __name__ == "__main__":
    main()
