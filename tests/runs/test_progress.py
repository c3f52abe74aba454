import io

from torchgrasp.runs.progress import Progress


def test_progress_in_a_file_is_a_line_now_and_then():
    stream = io.StringIO()
    with Progress(100, initial=40, description="train", interval=0.0, stream=stream) as progress:
        progress.update(10, success_rate=0.25)
    first, last = stream.getvalue().splitlines()
    assert first.startswith("train: 50/100 steps")
    assert "to go" in first and "success 25 %" in first
    assert "\r" not in last
    quiet = io.StringIO()
    Progress(100, stream=quiet).update(10)
    assert not quiet.getvalue()


def test_nothing_is_to_go_where_more_was_done_than_asked_for():
    stream = io.StringIO()
    with Progress(10, interval=0.0, stream=stream) as progress:
        progress.update(12)
    assert ", 00:00 to go" in stream.getvalue().splitlines()[0]
