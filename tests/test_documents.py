"""Documents are read in one strict way, whoever wrote them."""

import json
import os

import pytest
from pydantic import ValidationError

from tests.hostile_values import YAML_BOMB, check_each, check_texts
from torchgrasp.documents import (
    Amount,
    Count,
    Document,
    InnerPath,
    Name,
    Plain,
    RelativePath,
    parse_json,
    parse_yaml,
    read_document,
    read_text,
    read_yaml,
)
from torchgrasp.errors import CheckpointError, ConfigError, DamageError


class Part(Document):
    count: Count
    share: Amount


class Whole(Document):
    name: Name
    file: InnerPath
    parts: list[Part]
    more: Plain


WHOLE = {"name": "a", "file": "b/c.json", "parts": [{"count": 3, "share": 0.5}], "more": {"x": [1, None]}}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "whole.json"
    path.write_text(json.dumps(WHOLE))
    return path


def read(file):
    return read_document(file, Whole, "write it again")


def test_what_was_written_comes_back(file):
    assert read(file).model_dump() == WHOLE
    assert read(file) == Whole(**{**WHOLE, "parts": [Part(count=3, share=0.5)]})


def test_every_value_that_does_not_belong_there_is_refused(file):
    def write(document):
        file.write_text(json.dumps(document))

    free = ("more", "parts: list", "parts.0: left out")
    number = check_each(WHOLE, write, lambda: read(file), free=lambda words: words.startswith(free))
    assert number > 80


def test_files_that_are_no_documents_are_named(file):
    check_texts(file, lambda: read(file))


def test_a_fault_is_told_with_its_place_and_the_remedy(file):
    file.write_text(json.dumps({**WHOLE, "parts": [{"count": -1, "share": 0.5}]}))
    with pytest.raises(CheckpointError, match=r"whole\.json .*parts\.0\.count=-1.*write it again\.$"):
        read(file)
    with pytest.raises(ConfigError, match=r"parts\.0\.count"):
        read_document(file, Whole, "write it again", error=ConfigError)


def test_what_hides_from_the_eye_is_escaped(file):
    file.write_text(json.dumps({**WHOLE, "file": "../\x1b[31m\u202e"}))
    with pytest.raises(CheckpointError) as error:
        read(file)
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    "name", ["", ".", "..", "/etc/passwd", "../x", "a/../../x", "a//b", "./a", "a\0b", "a\nb", "a" * 300]
)
def test_a_path_stays_inside_the_folder(name):
    with pytest.raises(ValidationError):
        Whole(name="", file=name, parts=[], more={})


def test_a_relative_path_may_lead_elsewhere_but_not_from_the_root():
    class Place(Document):
        path: RelativePath

    assert Place(path="../../runs/a").path == "../../runs/a"
    for name in ("/etc", "", "a" * 300, "a\0b"):
        with pytest.raises(ValidationError):
            Place(path=name)


def test_missing_files_folders_pipes_and_endless_links_are_told(tmp_path):
    with pytest.raises(DamageError, match="is missing"):
        read_text(tmp_path / "none.json", "get it")
    with pytest.raises(DamageError, match="is missing"):
        read_text(tmp_path, "get it")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CheckpointError, match="no regular file"):
        read_text(tmp_path / "pipe", "get it")
    (tmp_path / "link").symlink_to("/dev/zero")
    with pytest.raises(CheckpointError, match="no regular file"):
        read_text(tmp_path / "link", "get it")
    (tmp_path / "round").symlink_to(tmp_path / "round")
    for name in ("round", "a" * 300, "a\0b"):
        with pytest.raises(CheckpointError, match="cannot be read"):
            read_text(tmp_path / name, "get it")


def test_numbers_that_are_none_are_read_where_a_schema_does_not_refuse_them():
    assert parse_json("[Infinity]", "it", "") == [float("inf")]


def test_yaml_without_references_is_read(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text("seed: 0\nenv: {horizon: 30}\n")
    assert read_yaml(file, "get it") == {"seed": 0, "env": {"horizon": 30}}
    for text in (
        YAML_BOMB,
        "[" * 1000,
        "{" * 70 + "}" * 70,
        "a: b: c",
        "\x00",
        "!!python/object:os.system {}",
    ):
        with pytest.raises(CheckpointError, match=r"config\.yaml cannot be used"):
            parse_yaml(text, file, "get it")
    check_texts_of_yaml(file)


def check_texts_of_yaml(file):
    for content in (b"\xff\xfe", b"\xef\xbb\xbfa: 1", b" " * (1 << 21)):
        file.write_bytes(content)
        with pytest.raises(CheckpointError, match=r"config\.yaml cannot be used"):
            read_yaml(file, "get it")
