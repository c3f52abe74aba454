"""The suite `franka`: a file of results that goes on where it was left, and its summary."""

import json

import franka_loop
import pytest

from torchgrasp.errors import ConfigError

ASKED = {"policy": "pretrained", "split": "val", "seed": 0, "objects": 3}


def row(number, **changes):
    facts = {"episode": number, "scene": number, "object": "box", "lifted": True, "risen": 0.15, "held": True}
    facts |= {"width": 0.04, "steps": 30, "cause": None, "reason": ""}
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
