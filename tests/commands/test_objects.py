import os
import subprocess
import sys

import pytest
import trimesh

from torchgrasp.__main__ import main
from torchgrasp.commands import object_table
from torchgrasp.objects import packaged


@pytest.fixture
def meshes(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHGRASP_CACHE", str(tmp_path / "cache"))
    (tmp_path / "kitchen").mkdir()
    trimesh.creation.box((0.04, 0.05, 0.12)).export(tmp_path / "kitchen" / "box.stl")
    trimesh.creation.box((0.2, 0.2, 0.2)).export(tmp_path / "kitchen" / "crate.stl")
    return tmp_path / "kitchen"


def test_the_table_tells_what_can_be_grasped_or_why_not(meshes, capsys):
    assert main(["objects", "folder", "--path", str(meshes), "--num-grasps", "100"]) == 0
    head, box, crate, total = capsys.readouterr().out.splitlines()
    assert head.split()[0] == "name" and "licence" in head
    assert "4.0 x 5.0 x 12.0" in box and " 100 " in box and "yes; unknown" in box
    assert "no: crate.stl has 0 grasps" in crate and "20.0 x 20.0 x 20.0 cm" in crate
    assert str(meshes) not in crate
    assert total.startswith("1 of 2 objects can be grasped")


def test_options_reach_the_set(meshes, capsys):
    assert main(["objects", "folder", "--path", str(meshes), "--limit", "1"]) == 0
    assert "crate" not in capsys.readouterr().out
    assert main(["objects", "folder", "--path", str(meshes), "--resize"]) == 0
    assert "2 of 2 objects" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["folder"], "error: folder needs --path"),
        (["folder", "--path", "nowhere"], "nowhere is not a directory"),
        (["ycb", "--split", "tset"], "split='tset'"),
        (["procedural", "--limit", "0"], "num_objects=0"),
        (["procedural", "--write-index"], "--write-index"),
    ],
)
def test_mistakes_get_one_line(arguments, message, capsys):
    assert main(["objects", *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_one_bad_entry_is_a_row_and_the_others_are_listed(meshes, capsys):
    (meshes / "gone.obj").symlink_to(meshes / "nowhere.obj")
    (meshes / "bottle.obj").mkdir()
    trimesh.creation.box((0.04, 0.05, 0.12)).export(meshes / "bottle.obj" / "mesh.stl")
    assert main(["objects", "folder", "--path", str(meshes), "--num-grasps", "100"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "no: gone.obj cannot be read" in rows["gone"]
    assert all("yes; unknown" in rows[name] for name in ("box", "bottle.obj/mesh"))


def test_names_of_files_reach_no_terminal_as_they_are(meshes, capsys):
    trimesh.creation.box((0.04, 0.05, 0.12)).export(meshes / "plain.stl")
    (meshes / "plain.stl").rename(meshes / os.fsdecode(b"\x1b[31mcaf\xe9.stl"))
    (meshes / "x\x1b[2J.obj").write_text("")
    assert main(["objects", "folder", "--path", str(meshes), "--num-grasps", "100"]) == 0
    told = capsys.readouterr()
    assert "\\x1b[31mcaf\\xe9" in told.out and "\x1b" not in told.out
    assert main(["objects", "folder", "--path", str(meshes / "\x1b[2J")]) == 1
    assert "\\x1b[2J is not a directory" in capsys.readouterr().err


def test_an_ascii_terminal_gets_the_table_too(meshes):
    (meshes / "box.stl").rename(meshes / "кружка.stl")
    command = [sys.executable, "-m", "torchgrasp", "objects", "folder", "--path", str(meshes)]
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(command, capture_output=True, env={**os.environ, **ascii_only}, timeout=120)
    assert done.returncode == 0 and b"\\u043a\\u0440\\u0443\\u0436\\u043a\\u0430 " in done.stdout


def test_a_spoon_is_taken_by_the_finger_tips(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TORCHGRASP_CACHE", str(tmp_path / "cache"))
    (tmp_path / "desk").mkdir()
    bowl = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    bowl.apply_scale((0.028, 0.019, 0.0065))
    bowl.apply_translation((0.085, 0, 0))
    spoon = trimesh.util.concatenate([trimesh.creation.box((0.13, 0.012, 0.004)), bowl])
    spoon.export(tmp_path / "desk" / "spoon.stl")
    assert main(["objects", "folder", "--path", str(tmp_path / "desk")]) == 0
    assert "1 of 1 objects can be grasped" in capsys.readouterr().out


def test_a_renewed_index_keeps_the_places_of_what_could_be_grasped(tmp_path, monkeypatch):
    for module in (object_table, packaged):
        monkeypatch.setattr(module, "INDEX_DIR", tmp_path)
    for pen, cup in (("lies flat", ""), ("", "")):
        reasons = {"pen": pen, "cup": cup, "tin": "", "wall": "too wide"}
        object_table.write_index("desk", [object_table.Row(name, "MIT", reasons[name]) for name in reasons])
        packaged.read_index.cache_clear()
    assert list(packaged.read_index("desk")) == ["cup", "tin", "pen", "wall"]
