"""Hydra's command line, on which paths are given as they are."""

import runpy
import sys
import textwrap

import pytest
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser

from tests.configurations import ROOT
from torchgrasp.config.recipe_main import as_written, find_fault

PATHS = (
    "/data/a=b",
    "/data/物体",
    "/data/Köln",
    "/data/meshes (v2)",
    "/data/[x]",
    "data(v2)",
    "/it's",
    "a\\'b",
)
PATHS += ('/a"b', "/a#b!;&<>^`", "/trailing=\\", "/café\udce9", "a=b=c", "=")


@pytest.mark.parametrize("path", PATHS)
def test_paths_are_taken_as_they_are_written(path):
    written = as_written(f"objects.path={path}")
    parsed = OverridesParser.create().parse_override(written)
    assert (parsed.key_or_group, parsed.value()) == ("objects.path", path)


@pytest.mark.parametrize(
    "override",
    [
        *("seed=3", "objects.path=/data/plain", "model=pointnet", "~transforms.table", "+loss.extra=1", "a="),
        *("online.milestones=[0.1,0.2]", "seed=1,2", "seed=range(1,5)", "x='it''s'", "name=null"),
        # Not finished, or no override: Hydra tells what is wrong.
        *("a=[1,2", "a={b: 1", "a='b", "seed=range(1,", "no override", "a b=c=d", "a=[x=y]", "a=x=y,[c,d]"),
    ],
)
def test_what_hydra_reads_or_should_judge_is_left_alone(override):
    assert as_written(override) == override


def test_a_sweep_stays_a_sweep_and_home_is_expanded(monkeypatch):
    monkeypatch.setenv("HOME", "/home/me")
    swept = OverridesParser.create().parse_override(as_written("objects.path=/a=b,/c,~/d"))
    assert swept.is_sweep_override()
    assert list(swept.sweep_string_iterator()) == ["'/a=b'", "/c", "'/home/me/d'"]
    assert as_written("+objects.path=~/it") == "+objects.path='/home/me/it'"


@pytest.fixture
def run_recipe_of_ones_own(tmp_path, monkeypatch, capsys):
    """Runs a small recipe as its command line would in this process; returns exit code, output and errors."""
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "main.yaml").write_text(
        f"path: null\nhydra: {{run: {{dir: {tmp_path}/out}}, sweep: {{dir: {tmp_path}/out}}}}\n"
    )
    (tmp_path / "recipe.py").write_text(
        textwrap.dedent("""
            import sys
            from torchgrasp.config import recipe_main

            @recipe_main(config_name="main", config_path="conf")
            def main(cfg):
                print(ascii(cfg.path), sys.argv[1:])

            if __name__ == "__main__":
                main()
        """)
    )
    monkeypatch.chdir(tmp_path)

    def run(*overrides: str) -> tuple[object, str, str]:
        monkeypatch.setattr(sys, "argv", ["recipe.py", *overrides])
        code: object = 0
        try:
            runpy.run_path(str(tmp_path / "recipe.py"), run_name="__main__")
        except SystemExit as ended:
            code = ended.code
        return code, *capsys.readouterr()

    yield run
    HydraConfig.instance().cfg = None


def test_a_recipe_of_ones_own_gets_the_path_and_the_command_line_stays(run_recipe_of_ones_own):
    assert run_recipe_of_ones_own("path=/data/a=b") == (0, "'/data/a=b' ['path=/data/a=b']\n", "")
    code, out, _ = run_recipe_of_ones_own("-m", "path=/a=b,/c")
    assert code == 0 and "'/a=b' " in out and "'/c' " in out
    code, _, err = run_recipe_of_ones_own("path=[1")
    assert code == 1 and "path=[1" in err and "Traceback" not in err


def test_no_configuration_is_unpickled(run_recipe_of_ones_own):
    code, _, err = run_recipe_of_ones_own("--experimental-rerun", "config.pickle")
    assert code == 2 and "unpickles a file" in err and "Traceback" not in err


@pytest.mark.parametrize("override", ["model=5", "model=null", "loss=[1,2]", "env=1.5", "+logger=true"])
def test_a_group_takes_names_of_its_files_alone(override):
    told = find_fault(ROOT / "conf", ["seed=3", override])
    assert told is not None and told.startswith(f"{override} is no choice: give one of ")


def test_choices_values_and_deletions_are_left_to_hydra():
    given = [
        "model=pointnet",
        "experiment=[laptop,table1/dagger]",
        "seed=3",
        "~model",
        "loss=td3_bc,bc",
    ]
    assert find_fault(ROOT / "conf", given) is None
