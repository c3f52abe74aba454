"""What the command prints of demonstrations that somebody else made."""

from tests.data.rollouts import make_episodes
from torchgrasp.__main__ import main
from torchgrasp.data import append_shard, begin_demonstrations


def test_names_cannot_steer_a_terminal(tmp_path, capsys):
    path = tmp_path / "demos"
    begin_demonstrations(path, provenance={"\x1b]0;title\x07": 1})
    episodes = make_episodes(0)[:2]
    append_shard(path, episodes, objects=["\x1b[2Jmug", "bowl\u202e"], seeds=[0, 1], index=0)
    assert main(["dataset", str(path)]) == 0
    told = capsys.readouterr().out
    assert all(line.isprintable() for line in told.splitlines())
    assert r"\x1b[2Jmug" in told and r"bowl\u202e" in told and r"\x1b]0;title\x07" in told


def test_a_message_cannot_steer_a_terminal(tmp_path, capsys):
    (tmp_path / "demos").mkdir()
    (tmp_path / "demos" / "card.json").write_text("\x1b[31m")
    assert main(["dataset", str(tmp_path / "demos")]) == 1
    assert main(["dataset", str(tmp_path / "\x1b[31m")]) == 1
    assert all(line.isprintable() for line in capsys.readouterr().err.splitlines())
