import json
import random
import subprocess
import sys
import textwrap
from itertools import pairwise

import numpy as np
import pytest
import torch

import torchgrasp
from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.errors import ConfigError, StorageError, check_range
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.runs.run_directory import hardware, make_run_dir, write_summary
from torchgrasp.runs.seeding import seed_everything
from torchgrasp.training.schedules import cosine_schedule, linear_schedule, step_schedule
from torchgrasp.versions import versions


def test_run_directories_never_coincide(tmp_path):
    paths = {make_run_dir("td3_bc", root=tmp_path) for _ in range(4)}
    assert len(paths) == 4
    assert all(path.is_dir() and path.parent == tmp_path / "td3_bc" for path in paths)


def test_summary_holds_what_a_number_needs_behind_it(tmp_path):
    table = SuccessTable()
    table.add("mug", True)
    counts = {"wall_seconds": 1.5, "env_steps": 30, "gradient_steps": 4}
    written = write_summary(tmp_path, {**table.summary(), **counts, "note": "kept"})
    assert json.loads((tmp_path / "summary.json").read_text()) == written
    assert written["note"] == "kept"
    assert written["versions"]["torch"] == versions()["torch"]
    assert written["versions"]["torchgrasp"] == torchgrasp.__version__
    assert written["hardware"] == hardware()
    with pytest.raises(ConfigError, match="env_steps"):
        write_summary(tmp_path, table.summary())


def test_one_seed_reaches_every_generator():
    draws = []
    for seed in (3, 3, 4):
        generator = seed_everything(seed)
        draws.append(
            (
                random.random(),
                np.random.rand(),
                torch.rand(()).item(),
                torch.rand((), generator=generator).item(),
            )
        )
    assert draws[0] == draws[1]
    assert all(a != b for a, b in zip(draws[0], draws[2], strict=True))


def test_a_users_error_is_one_line_and_exit_code_1(capsys):
    with pytest.raises(SystemExit) as exit_info, one_line_errors():
        check_range("tau", 2.0, 0.0, 1.0)
    assert exit_info.value.code == 1
    assert capsys.readouterr().err == "error: tau=2.0 is out of range: give a value in [0.0, 1.0].\n"


def test_an_error_inside_hydras_instantiate_is_one_line_too(tmp_path):
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "main.yaml").write_text(
        textwrap.dedent(f"""
            part: {{_target_: torchgrasp.errors.check_range, name: tau, value: 2.0, low: 0.0, high: 1.0}}
            hydra: {{run: {{dir: {tmp_path}/out}}}}
        """)
    )
    (tmp_path / "recipe.py").write_text(
        textwrap.dedent("""
            import hydra
            from torchgrasp.config.one_line_errors import one_line_errors

            @hydra.main(version_base=None, config_path="conf", config_name="main")
            @one_line_errors()
            def main(cfg):
                hydra.utils.instantiate(cfg.part)

            main()
        """)
    )
    command = [sys.executable, "-W", "ignore", str(tmp_path / "recipe.py")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert result.stderr.splitlines() == ["error: tau=2.0 is out of range: give a value in [0.0, 1.0]."]


def test_a_bug_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError), one_line_errors():
        _ = 1 / 0


def test_schedules_drive_an_optimizer():
    parameter = torch.nn.Parameter(torch.zeros(1))
    optimizer = torch.optim.SGD([parameter], lr=0.5)
    scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, step_schedule([2, 3], gamma=0.1))
    rates = []
    for _ in range(4):
        rates.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        scheduler.step()
    assert rates == pytest.approx([0.5, 0.5, 0.05, 0.005])


def test_cosine_rises_falls_and_stays():
    factor = cosine_schedule(100, warmup_steps=20, final=0.1)
    values = [factor(step) for step in range(150)]
    assert values[:20] == pytest.approx([(step + 1) / 20 for step in range(20)])
    assert all(a >= b for a, b in pairwise(values[20:]))
    assert values[60] == pytest.approx(0.55)
    assert values[100:] == pytest.approx([0.1] * 50)


@pytest.mark.parametrize(
    "make",
    [
        lambda: step_schedule([5, 3]),
        lambda: step_schedule([3], gamma=0.0),
        lambda: cosine_schedule(10, warmup_steps=10),
        lambda: linear_schedule(1.0, 0.0, 0),
    ],
)
def test_schedules_that_are_none_are_refused(make):
    with pytest.raises(ConfigError):
        make()


def test_a_run_directory_appears_with_its_first_files(tmp_path):
    path = make_run_dir("bc", root=tmp_path, files={"config.yaml": "é: 1\n"})
    assert (path / "config.yaml").read_text(encoding="utf-8") == "é: 1\n"
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_a_run_directory_that_cannot_be_made_leaves_nothing(tmp_path):
    with pytest.raises(StorageError, match=r"bc cannot be written \(File name too long\)"):
        make_run_dir("bc", root=tmp_path, files={"config.yaml": "", 300 * "x": ""})
    assert not list((tmp_path / "bc").iterdir())
    with pytest.raises(StorageError, match=r"a file stands in its way"):
        make_run_dir("bc", root="/dev/null")
