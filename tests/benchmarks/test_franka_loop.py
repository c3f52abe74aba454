"""The suite `franka`: a file of results that goes on where it was left, and its summary."""

import json

import franka_loop
import pytest

from torchgrasp.deploy import ArmLimits
from torchgrasp.errors import ConfigError

ASKED = {"policy": "pretrained", "split": "val", "seed": 0, "objects": 3, "watchdog": 0.1}


def row(number, **changes):
    facts = {"episode": number, "scene": number, "object": "box", "lifted": True, "risen": 0.15, "held": True}
    facts |= {"width": 0.04, "steps": 30, "cause": None, "reason": "", "caught": True, "left_out": 0}
    return ASKED | facts | changes


def test_the_summary_counts_lifts_and_stops_by_cause():
    stop = {"lifted": False, "held": False, "width": None, "cause": "limits"}
    rows = [row(0), row(1, **stop), row(2, lifted=False), row(3)]
    summary = franka_loop.summarize(rows)
    assert (summary["lifted"], summary["episodes"], summary["stops"]) == (2, 4, {"limits": 1})
    assert summary["held_but_not_lifted"] == 1 and summary["lifted_but_not_held"] == 0
    assert summary["success_ci95"][0] < 0.5 < summary["success_ci95"][1]


def test_a_file_of_other_options_is_refused(composed, tmp_path):
    file = tmp_path / "results.jsonl"
    file.write_text(json.dumps(row(0, split="test")) + "\n")
    with pytest.raises(ConfigError, match="give another file, or the same options"):
        franka_loop.benchmark_franka(
            composed(f"franka.results={file}", "franka.split=val", "franka.objects=3")
        )


def test_what_slipped_is_told_from_what_was_missed():
    missed = {"lifted": False, "held": False, "caught": False, "width": 0.0}
    stop = {**missed, "cause": "late", "width": None}
    rows = [row(0), row(1, **missed | {"caught": True}), row(2, **missed), row(3, **stop)]
    assert [franka_loop.name_outcome(each) for each in rows] == ["lifted", "slipped", "missed", "late"]
    assert franka_loop.summarize(rows)["outcomes"] == {"lifted": 1, "slipped": 1, "missed": 1, "late": 1}


def test_scenes_that_were_left_out_are_counted():
    assert franka_loop.summarize([row(0, left_out=2), row(1), row(2, left_out=1)])["left_out"] == 3


def test_scenes_of_which_none_suits_the_arm_come_to_an_end(composed, tmp_path):
    narrow = ArmLimits(workspace=((0.1, -0.01, 0.0), (0.11, 0.01, 1.0)))
    options = ["franka.split=val", "franka.objects=1", f"franka.results={tmp_path / 'results.jsonl'}"]
    with pytest.raises(
        ConfigError, match=r"any of 100 scenes in a row .* outside .*give another franka\.policy"
    ):
        franka_loop.benchmark_franka(composed(*options), narrow)


def write(file, *rows, end=""):
    file.write_text("".join(json.dumps(each) + "\n" for each in rows) + end)


@pytest.mark.parametrize("length", [1, 5, 12, 80, -1, None])
def test_a_last_line_that_is_half_written_is_dropped(length, tmp_path, capsys):
    file = tmp_path / "results.jsonl"
    write(file, row(0), row(1), end=json.dumps(row(2))[:length])
    assert franka_loop.read_rows(file, ASKED) == [row(0), row(1)]
    assert "half written" in capsys.readouterr().out
    assert len(file.read_text().splitlines()) == 2
    with file.open("a") as stream:
        stream.write(json.dumps(row(2)) + "\n")
    assert franka_loop.read_rows(file, ASKED) == [row(0), row(1), row(2)]
    assert not capsys.readouterr().out


@pytest.mark.parametrize("text", ["notes of mine", '{"policy": "pre\n', "[1]\n", "7\n"])
def test_a_file_that_is_none_of_results_is_refused_and_stays(text, tmp_path):
    file = tmp_path / "results.jsonl"
    write(file, row(0), end=text)
    before = file.read_bytes()
    with pytest.raises(ConfigError, match="in line 2: give another file"):
        franka_loop.read_rows(file, ASKED)
    assert file.read_bytes() == before


@pytest.mark.parametrize("other", [{"watchdog": 0.2}, {"seed": 1}, {"policy": "mine"}])
def test_every_option_is_checked_before_a_run_goes_on(other, tmp_path):
    file = tmp_path / "results.jsonl"
    write(file, row(0, **other), end='{"pol')
    before = file.read_bytes()
    with pytest.raises(ConfigError, match="give another file, or the same options"):
        franka_loop.read_rows(file, ASKED)
    assert file.read_bytes() == before and not franka_loop.read_rows(tmp_path / "none.jsonl", ASKED)


@pytest.mark.slow
def test_episodes_are_added_to_the_file_until_there_are_enough(composed, tmp_path, capsys):
    file = tmp_path / "results.jsonl"
    file.write_text(json.dumps(row(0)) + "\n")
    film = tmp_path / "film.mp4"
    options = ["franka.split=val", "franka.objects=3", f"franka.results={file}"]
    summary, *rows = franka_loop.benchmark_franka(composed(*options, "franka.episodes=2"))
    assert len(rows) == 2 == len(file.read_text().splitlines()) == summary["episodes"]
    assert rows[1]["scene"] > 0 and rows[1]["episode"] == 1
    again = [*options[:2], f"franka.results={tmp_path / 'other.jsonl'}", f"franka.film={film}"]
    franka_loop.benchmark_franka(composed(*again, "franka.episodes=1"))
    assert film.stat().st_size > 10_000 and "Film: " in capsys.readouterr().out
