import os
import re

import pytest
import trimesh

from torchgrasp.errors import ConfigError
from torchgrasp.objects import FolderObjects
from torchgrasp.objects.scales import read_scales

NAMES = {"mug": "mug", "sub/ball": "sub/ball", "sub/ball.ply": "sub/ball"}


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("a.csv", "name,scale\nmug, 0.001\nsub/ball,2\n"),
        ("b.csv", "mug,1e-3\n\nsub/ball,2.0\n"),
        ("c.yaml", "mug: 0.001\nsub/ball: 2\n"),
        ("bom.csv", "\ufeffname,scale\r\nmug,0.001\r\nsub/ball,2\r\n"),  # Excel's CSV UTF-8
        ("bom.yaml", "\ufeffmug: 0.001\nsub/ball: 2\n"),
        ("head.csv", " Name , SCALE \nmug,0.001\nsub/ball.ply,2\n"),
        ("semicolons.csv", "\ufeffName;Scale\r\nmug;0,001\r\nsub/ball;2,0;\r\n;;\r\n"),
        ("tabs.csv", "mug\t0,001\nsub/ball\t2\n"),
        ("mac.csv", "name,scale\rmug,0.001\rsub/ball,2\r"),
        ("quoted.csv", 'mug,"0.001"\n"sub/ball",2,,\n'),
    ],
)
def test_tables_as_programs_write_them(tmp_path, file, text):
    (tmp_path / file).write_text(text, encoding="utf-8", newline="")
    assert read_scales(tmp_path / file, NAMES) == {"mug": 0.001, "sub/ball": 2.0}


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("a.csv", "cup,1", r"'cup'.*it holds mug, sub/ball"),
        ("a.csv", "mug,0", "scales mug by '0': give a positive"),
        ("a.yaml", "mug: -1", "scales mug by '-1': give a positive"),
        ("a.yaml", "mug: true", "scales mug by 'true'"),
        ("a.yaml", "mug: [1, 2]", "scales mug by"),
        ("a.yaml", "mug: {}", "scales mug by {}"),
        ("a.csv", "mug,large", "by 'large'"),
        ("a.csv", "mug,inf", "by 'inf'"),
        ("a.csv", "mug,nan", "by 'nan'"),
        ("a.csv", "mug,1e300", "by '1e300': give a positive factor to metres, at most 1e\\+06"),
        ("a.csv", "mug,1e-300", "by '1e-300'"),
        ("a.csv", "name,scale,note\nmug,1,old", "'name,scale,note': each is 'name,scale'"),
        ("a.csv", "mug,0,001", "'mug,0,001': each is"),
        ("a.csv", "mug;0.001;x", "'mug;0.001;x': each is 'name;scale'"),
        ("a.csv", "sub/ball,1\nsub/ball.ply,2", "'sub/ball' twice"),
        ("a.csv", "x" * 200_000, "no CSV file|each is"),
        ("a.csv", "mug,1\nmug,2", "'mug' twice"),
        ("a.csv", "mug", "'name,scale'"),
        ("a.yaml", "[mug]", "'name: scale'"),
        ("a.yaml", "mug: [", "no YAML"),
        ("a.txt", "mug,1", r"\.csv, \.yaml or \.yml"),
    ],
)
def test_bad_tables_are_refused_in_one_line(tmp_path, file, text, message):
    (tmp_path / file).write_text(text)
    with pytest.raises(ConfigError, match=rf"(?s){file}.*{message}"):
        read_scales(tmp_path / file, NAMES)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_scales(tmp_path / "none.csv", NAMES)


BOMB = "\n".join(f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]" for i in range(1, 12))


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("café,1".encode("latin-1"), "is not UTF-8 .*save it as 'CSV UTF-8'"),
        ("name,scale".encode("utf-16"), "is not UTF-8"),
        (b"\x00\x01\x02", "each is 'name,scale'|no CSV file"),
        (f"l0: &l0 [1]\n{BOMB}".encode(), "which is no object|scales"),
        (b"[" * 100_000, "no YAML|no table"),
        (b"2024-99-99: 1", "which is no object"),
    ],
)
def test_what_is_no_table_is_one_short_line(tmp_path, content, told):
    for suffix in ("csv", "yaml"):
        (tmp_path / f"a.{suffix}").write_bytes(content)
        with pytest.raises(ConfigError) as caught:
            read_scales(tmp_path / f"a.{suffix}", NAMES)
        message = str(caught.value)
        assert str(tmp_path / f"a.{suffix}") in message and len(message) < 600 + len(str(tmp_path))
        if suffix == ("yaml" if content[:1] in b"[l2" else "csv"):
            assert re.search(told, message)


def test_only_files_of_a_sensible_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(ConfigError, match="no regular file"):
        read_scales(tmp_path / "pipe.csv", NAMES)
    with (tmp_path / "huge.csv").open("wb") as file:
        file.truncate(20_000_000)
    with pytest.raises(ConfigError, match="larger than 10 MB"):
        read_scales(tmp_path / "huge.csv", NAMES)


def test_a_folder_scales_single_objects(tmp_path):
    trimesh.creation.box((40, 50, 120)).export(tmp_path / "mm.stl")
    trimesh.creation.box((0.03, 0.05, 0.1)).export(tmp_path / "metres.stl")
    (tmp_path / "scales.csv").write_text("mm,0.001\n")
    objects = FolderObjects(
        tmp_path, scale_table=tmp_path / "scales.csv", num_grasps=100, cache_dir=tmp_path / "cache"
    )
    assert objects.names == ("metres", "mm")
    assert objects[0].size == pytest.approx((0.03, 0.05, 0.1))
    assert objects[1].size == pytest.approx((0.04, 0.05, 0.12))
