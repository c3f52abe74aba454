import pytest
import trimesh

from torchgrasp.__main__ import main


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
