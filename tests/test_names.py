"""Names and paths from outside: control characters, bytes of no encoding, long and odd ones."""

import io
import os
import sys
from pathlib import Path

import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.names import (
    file_stem,
    object_name,
    one_line,
    printable,
    to_path,
    write_out_what_cannot_be_encoded,
)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("mug", "mug"),
        ("кружка 物体 é", "кружка 物体 é"),
        ("\x1b[31mred\x07", "\\x1b[31mred\\x07"),
        ("a\nb\r\tc\x9b", "a\\nb\\r\\tc\\x9b"),
        ("gpj.\u202egum", "gpj.\\u202egum"),
        ("caf\udce9", "caf\\udce9"),
        (7, "7"),
    ],
)
def test_what_would_move_a_cursor_or_hide_words_is_written_out(text, shown):
    assert printable(text) == shown
    printable(text).encode()


def test_a_line_is_one_line():
    assert one_line("a\n  b\x1b[2J") == "a b\\x1b[2J"


def test_objects_are_called_the_same_on_every_system():
    assert object_name(Path("kitchen/mug")) == "kitchen/mug"
    assert object_name(Path(os.fsdecode(b"caf\xe9"))) == "caf\\xe9"
    assert object_name(Path("Ko\u0308ln")) == "Köln"  # as macOS writes it
    assert object_name(Path("a\x1b[31m")) == "a\\x1b[31m"


@pytest.mark.parametrize("name", ["x" * 240, "кружка" * 30, "a/../b", "a\x00b", "caf\udce9"])
def test_names_of_files_fit_every_file_system(tmp_path, name):
    stem = file_stem(name)
    assert stem.isascii() and len(stem) <= 60
    (tmp_path / f"{stem}-key.npz").touch()
    assert file_stem("sub/random-000") == "random-000"


def test_paths_are_text_and_their_home_is_known(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert to_path("path", "~/meshes") == tmp_path / "meshes" == to_path("path", tmp_path / "meshes")
    for wrong in (2024, None, ["x"], True):
        with pytest.raises(ConfigError, match=r"^path=.* is no path: give one as text"):
            to_path("path", wrong)
    with pytest.raises(ConfigError, match="null character"):
        to_path("path", "a\0b")
    with pytest.raises(ConfigError, match="no home directory is known"):
        to_path("path", "~nobody_of_this_name/meshes")


def test_standard_output_writes_out_what_its_encoding_lacks(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    write_out_what_cannot_be_encoded()
    print("кружка", flush=True)
    assert stream.buffer.getvalue() == b"\\u043a\\u0440\\u0443\\u0436\\u043a\\u0430\n"  # pyright: ignore
