import pytest
import trimesh

from torchgrasp.errors import ConfigError
from torchgrasp.objects import FolderObjects
from torchgrasp.objects.scales import read_scales

NAMES = ("mug", "sub/ball")


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("a.csv", "name,scale\nmug, 0.001\nsub/ball,2\n"),
        ("b.csv", "mug,1e-3\n\nsub/ball,2.0\n"),
        ("c.yaml", "mug: 0.001\nsub/ball: 2\n"),
    ],
)
def test_tables_in_both_formats(tmp_path, file, text):
    (tmp_path / file).write_text(text)
    assert read_scales(tmp_path / file, NAMES) == {"mug": 0.001, "sub/ball": 2.0}


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("a.csv", "cup,1", r"'cup'.*it holds mug, sub/ball"),
        ("a.csv", "mug,0", "scales mug by '0': give a positive"),
        ("a.yaml", "mug: -1", "scales mug by -1: give a positive"),
        ("a.yaml", "mug: true", "scales mug by True"),
        ("a.csv", "mug,large", "by 'large'"),
        ("a.csv", "mug,inf", "by 'inf'"),
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
