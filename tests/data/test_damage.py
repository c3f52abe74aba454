"""Damaged demonstrations: found on opening, named, and never trained on."""

import contextlib
import json
import resource
import shutil

import pytest
import torch

from tests.data.rollouts import append, make_episodes
from tests.hostile_values import check_each, check_texts
from torchgrasp.data import begin_demonstrations, drop_damaged_shards, open_demonstrations
from torchgrasp.data.demonstration_card import add_to_card, empty_card
from torchgrasp.data.files import describe_file, seal_json
from torchgrasp.data.shards import shard_name
from torchgrasp.errors import CheckpointError, ConfigError


@pytest.fixture
def path(tmp_path):
    for index in range(3):
        append(tmp_path / "demos", index)
    return tmp_path / "demos"


def flip(file, place):
    content = bytearray(file.read_bytes())
    content[place] ^= 1
    file.write_bytes(content)


def test_one_flipped_byte_is_found_in_every_file(path):
    files = [each for each in path.rglob("*") if each.is_file()]
    assert {each.name for each in files} >= {"card.json", "shard.json", "meta.json", "points.memmap"}
    for file in files:
        for place in (0, file.stat().st_size // 2, file.stat().st_size - 1):
            flip(file, place)
            with pytest.raises(CheckpointError) as error:
                open_demonstrations(path)
            assert str(file) in str(error.value)
            flip(file, place)
    open_demonstrations(path)


def test_every_missing_or_shortened_file_is_named(path):
    for file in [each for each in path.rglob("*") if each.is_file()]:
        content = file.read_bytes()
        file.write_bytes(content[:-1])
        with pytest.raises(CheckpointError, match=r"bytes instead of|cut short") as error:
            open_demonstrations(path, verify=False)
        assert str(file) in str(error.value)
        file.unlink()
        with pytest.raises(CheckpointError, match="is missing") as error:
            open_demonstrations(path, verify=False)
        assert str(file) in str(error.value)
        file.write_bytes(content)


def test_verification_can_be_left_out(path):
    file = path / "shard_00001" / "rows" / "points.memmap"
    flip(file, 100)
    assert open_demonstrations(path, verify=False).num_shards == 3


def test_missing_shards_are_named(path):
    shutil.move(path / "shard_00002", path.parent / "away")
    with pytest.raises(CheckpointError, match="lacks shard_00002"):
        open_demonstrations(path)
    shutil.move(path.parent / "away", path / "shard_00002")
    shutil.rmtree(path / "shard_00000")
    with pytest.raises(CheckpointError, match="lacks shard_00000"):
        open_demonstrations(path)
    with pytest.raises(CheckpointError, match="no demonstrations"):
        open_demonstrations(path / "nowhere")


def test_a_card_of_other_shards_is_refused(path):
    append(path.parent / "others", 0, make_episodes(7))
    shutil.copy(path.parent / "others" / "card.json", path / "card.json")
    with pytest.raises(CheckpointError, match=r"card\.json tells of other shards"):
        open_demonstrations(path)


def test_a_process_killed_before_it_wrote_the_card_leaves_no_damage(path):
    card = (path / "card.json").read_bytes()
    told = append(path, 3)
    (path / "card.json").write_bytes(card)
    assert open_demonstrations(path).card == told
    append(path, 4)
    assert open_demonstrations(path).num_shards == 5


def test_damaged_shards_are_dropped_and_made_again(path):
    whole = open_demonstrations(path)
    episodes = [episode.clone() for episode in whole.iterate_episodes()]
    flip(path / "shard_00001" / "rows" / "action.memmap", 5)
    assert drop_damaged_shards(path) == ["shard_00001", "shard_00002"]
    assert open_demonstrations(path).card["shards"] == 1
    for index in (1, 2):
        append(path, index)
    again = open_demonstrations(path)
    assert again.card == whole.card
    for old, new in zip(episodes, again.iterate_episodes(), strict=True):
        assert torch.equal(old["points"], new["points"])
    shutil.rmtree(path / "shard_00001")
    assert drop_damaged_shards(path) == ["shard_00002"] and open_demonstrations(path).num_shards == 1
    assert drop_damaged_shards(path) == []


def test_shards_that_only_cannot_be_read_now_are_kept(path):
    """Too many open files, and a link that ends nowhere."""
    before, limit = open_demonstrations(path).card, resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, limit[1]))
    try:
        with pytest.raises(CheckpointError, match="does not mean that it is damaged"):
            drop_damaged_shards(path)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limit)
    assert open_demonstrations(path).card == before
    file = path / "shard_00001" / "rows" / "goal.memmap"
    file.rename(path / "away")
    file.symlink_to(file)
    with pytest.raises(CheckpointError, match="does not mean that it is damaged"):
        drop_damaged_shards(path)
    (path / "away").replace(file)
    assert open_demonstrations(path).card == before


def test_shards_of_another_format_are_kept(path):
    file = path / "shard_00001" / "shard.json"
    shard = json.loads(file.read_text())
    del shard["crc32"]
    file.write_text(seal_json({**shard, "format": 3}))
    with pytest.raises(CheckpointError, match=r"format 3.*reads format 2"):
        drop_damaged_shards(path)
    assert file.exists() and (path / "shard_00002").exists()


def test_imports_are_not_dropped(tmp_path):
    begin_demonstrations(tmp_path / "demos", provenance={"imported_from": "others/grasps-v0"})
    append(tmp_path / "demos", 0)
    flip(tmp_path / "demos" / "shard_00000" / "rows" / "action.memmap", 5)
    with pytest.raises(ConfigError, match="imported from others/grasps-v0"):
        drop_damaged_shards(tmp_path / "demos")
    assert (tmp_path / "demos" / "shard_00000").exists()


def test_nothing_is_dropped_where_nothing_is(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(CheckpointError, match="no demonstrations at"):
            drop_damaged_shards(path)


def test_older_formats_are_told_apart_from_damage(path):
    card = json.loads((path / "card.json").read_text())
    del card["crc32"]
    (path / "card.json").write_text(seal_json({**card, "format": 3}))
    with pytest.raises(CheckpointError, match=r"format 3.*reads format 2"):
        open_demonstrations(path)
    (path / "origin.json").write_text("{}")
    with pytest.raises(CheckpointError, match=r"format 1.*reads format 2"):
        open_demonstrations(path)


def reseal(path, document):
    filled = isinstance(document, dict) and document
    path.write_text(seal_json(document) if filled else json.dumps(document))


def unseal(path):
    document = json.loads(path.read_text())
    del document["crc32"]
    return document


def write_shard(path, number, shard):
    """Put a shard.json in its place, and as far as it goes the card that tells of it."""
    reseal(path / shard_name(number) / "shard.json", shard)
    card = unseal(path / "card.json")
    with contextlib.suppress(Exception):
        shards = [unseal(path / shard_name(each) / "shard.json") for each in range(3)]
        summary = empty_card(card["kind"], card["provenance"])
        for each in shards:
            summary = add_to_card(summary, each)
        reseal(path / "card.json", summary)


def names_no_schema_knows(words):
    """Names, seeds, times and versions may be any that could be."""
    place, _, kind = words.partition(": ")
    parts = place.split(".")
    if kind in ("left out", "more"):
        return "provenance" in parts or (parts[0] in ("objects", "versions") and len(parts) > 1)
    return "provenance" in parts or "seed" in parts or "seeds" in parts


def test_a_hostile_shard_with_a_right_checksum_is_refused(path):
    shard = unseal(path / "shard_00001" / "shard.json")
    card = (path / "card.json").read_bytes()

    def write(document):
        (path / "card.json").write_bytes(card)
        write_shard(path, 1, document)

    assert (
        check_each(shard, write, lambda: open_demonstrations(path), free=names_no_schema_knows, every=3) > 100
    )


def test_a_hostile_card_with_a_right_checksum_is_refused(path):
    card = unseal(path / "card.json")

    def write(document):
        reseal(path / "card.json", document)

    assert (
        check_each(card, write, lambda: open_demonstrations(path), free=names_no_schema_knows, every=3) > 60
    )


def test_hostile_rows_with_right_checksums_are_refused(path):
    file, shard = path / "shard_00001" / "rows" / "meta.json", path / "shard_00001" / "shard.json"
    told = unseal(shard)
    sizes = {each: each.stat().st_size for each in file.parent.iterdir() if each != file}

    def write(document):
        file.write_text(json.dumps(document))
        told["files"]["rows/meta.json"] = describe_file(file)
        write_shard(path, 1, told)

    def free(words):
        return words == "device: left out" or words.endswith("is_nested: left out")

    meta = json.loads(file.read_text())
    assert check_each(meta, write, lambda: open_demonstrations(path), free=free, every=4) > 100
    assert {each: each.stat().st_size for each in sizes} == sizes


def test_reading_demonstrations_writes_nothing(path):
    before = {
        file: (file.read_bytes(), file.stat().st_mtime_ns) for file in path.rglob("*") if file.is_file()
    }
    for rows in open_demonstrations(path).shards:
        rows["points"].zero_()
    assert {f: (f.read_bytes(), f.stat().st_mtime_ns) for f in path.rglob("*") if f.is_file()} == before
    open_demonstrations(path)


def test_files_that_are_no_documents_are_named(path):
    for file in (path / "card.json", path / "shard_00001" / "shard.json"):
        content = file.read_bytes()
        check_texts(file, lambda: open_demonstrations(path))
        file.write_bytes(content)


def test_a_file_that_no_shard_tells_of_is_named(path):
    (path / "shard_00001" / "rows" / "more.memmap").write_bytes(b"1")
    with pytest.raises(CheckpointError, match=r"more\.memmap is no file of the shard"):
        open_demonstrations(path)
