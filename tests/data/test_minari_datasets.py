"""Minari datasets, written and read by Minari itself."""

import contextlib
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch

from tests.data.rollouts import append
from tests.hostile_values import check_each, check_texts
from torchgrasp.__main__ import main
from torchgrasp.data import begin_demonstrations, open_demonstrations
from torchgrasp.data.minari.exchange import export_minari, import_minari
from torchgrasp.errors import CheckpointError, ConfigError

minari = pytest.importorskip("minari")
NAME = "torchgrasp/grasps-v0"


@pytest.fixture
def demonstrations(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    begin_demonstrations(tmp_path / "demos", kind="failed", provenance={"seed": 3})
    for index in range(2):
        append(tmp_path / "demos", index)
    return open_demonstrations(tmp_path / "demos")


def test_everything_comes_back_row_for_row(demonstrations, tmp_path):
    export_minari(demonstrations, NAME)
    card = import_minari(NAME, tmp_path / "back")
    back = open_demonstrations(tmp_path / "back")
    assert back.card == card
    pairs = zip(demonstrations.iterate_episode_rows(), back.iterate_episode_rows(), strict=True)
    for (record, rows), (other_record, other) in pairs:
        assert record == other_record
        assert set(rows.keys()) == set(other.keys())
        for key in rows.keys():  # noqa: SIM118 - a tensordict iterates over its rows
            assert torch.equal(rows[key], other[key]) and rows[key].dtype == other[key].dtype
    same = ("kind", "episodes", "successes", "attempts", "steps", "perturbed_steps", "objects", "seeds")
    assert {name: card[name] for name in same} == {name: demonstrations.card[name] for name in same}
    assert card["provenance"] == {"seed": 3, "imported_from": NAME}


def test_minari_reads_the_export(demonstrations):
    export_minari(demonstrations, NAME)
    assert set(minari.list_local_datasets()) == {NAME}
    dataset = minari.load_dataset(NAME)
    assert (dataset.total_episodes, dataset.total_steps) == (
        demonstrations.num_episodes,
        demonstrations.card["steps"],
    )
    decoded = list(demonstrations.iterate_episodes())
    for episode, steps in zip(dataset.iterate_episodes(), decoded, strict=True):
        assert dataset.observation_space["points"].shape == (8, 3)
        points = episode.observations["points"]
        assert points.dtype == np.float16 and points.shape == (len(steps) + 1, 8, 3)
        np.testing.assert_array_equal(points[:-1], steps["points"][:, :8, :3].half().numpy())
        np.testing.assert_array_equal(episode.actions, steps["action"].numpy())
        np.testing.assert_array_equal(episode.infos["expert_action"][:-1], steps["expert_action"].numpy())
        np.testing.assert_array_equal(episode.rewards, steps["next", "reward"][:, 0].numpy())
        assert not episode.infos["has_expert"][-1] or episode.truncations[-1]
        assert bool(episode.truncations[-1]) != bool(episode.terminations[-1])
        if episode.truncations[-1]:
            assert episode.observations["time_left"][-1] == steps["next", "time_left"][-1].item()
    dataset.set_seed(0)
    assert len(dataset.sample_episodes(3)) == 3


def test_datasets_of_others_come_without_labels(tmp_path):
    space = make_space(STATES)
    episodes = [record_episode(space, length, length) for length in (3, 5)]
    dataset = write_dataset(tmp_path / "other-v1", space, episodes)
    card = import_minari(dataset, tmp_path / "demos", kind="expert")
    assert (card["episodes"], card["steps"], card["successes"], card["labelled_steps"]) == (2, 8, 2, 0)
    assert card["seeds"] == [3, 5] and set(card["objects"]) == {"unknown"}
    steps = torch.cat(list(open_demonstrations(tmp_path / "demos").iterate_episodes()))
    assert torch.allclose(
        steps["points"][0, :20, :3], torch.from_numpy(episodes[0]["observations"]["points"][0]), atol=0.01
    )


STATES = {"points": (20, 3), "time_left": (1,)}


def make_space(states):
    from gymnasium import spaces

    return spaces.Dict({name: spaces.Box(0, 1, shape) for name, shape in states.items()})


def record_episode(space, length, seed, actions=6):
    space.seed(seed)
    states = [space.sample() for _ in range(length + 1)]
    end = np.arange(length) == length - 1
    return {
        "seed": seed,
        "observations": {name: np.stack([state[name] for state in states]) for name in states[0]},
        "actions": np.zeros((length, actions), np.float32),
        "rewards": end.astype(float),
        "terminations": end,
        "truncations": np.zeros(length, bool),
    }


def write_dataset(folder, space, episodes):
    from gymnasium import spaces

    folder.mkdir()
    actions = spaces.Box(-1, 1, episodes[0]["actions"].shape[1:])
    storage = minari.dataset.minari_storage.MinariStorage.new(folder / "data", space, actions)
    storage.update_episodes([minari.data_collector.EpisodeBuffer(**each) for each in episodes])
    storage.update_metadata({"dataset_id": folder.name, "minari_version": minari.__version__})
    return folder


@pytest.mark.parametrize(
    ("states", "actions", "told"),
    [
        ({"points": (20, 3)}, 6, "no 'time_left'"),
        ({"points": (20, 4), "time_left": (1,)}, 6, "gripper_points=False"),
        (STATES, 7, r"Episode 0: 'actions' has the shape \(3, 7\)"),
    ],
)
def test_datasets_that_are_no_grasping_are_refused(tmp_path, states, actions, told):
    space = make_space(states)
    dataset = write_dataset(tmp_path / "other-v0", space, [record_episode(space, 3, 0, actions)])
    with pytest.raises(ConfigError, match=told):
        import_minari(dataset, tmp_path / "demos")


def spoil(column, value, name=None):
    """A change of an episode's column, or of one observation or info in it."""

    def change(episode):
        part = episode if name is None else episode.setdefault(column, {})
        part[name or column] = value(part.get(name or column))

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (spoil("observations", lambda x: np.full_like(x, np.nan), "points"), "Episode 1: 'points' holds NaN"),
        (spoil("observations", lambda x: x + 7e4, "points"), "Episode 1: 'points' .* beyond torch.float16"),
        (spoil("observations", lambda x: 5 * x + 2, "time_left"), r"Episode 1: 'time_left' .*\[0, 1\]"),
        (spoil("observations", lambda x: x[:-1], "time_left"), r"'time_left' has the shape \(5, 1\)"),
        (spoil("observations", lambda x: np.repeat(x, 3, 1), "time_left"), r"expected \(6, 1\)"),
        (spoil("observations", lambda x: np.repeat(x, 2, 1), "points"), "Episode 1 has 'points'"),
        (spoil("actions", lambda x: np.full_like(x, np.inf)), "Episode 1: 'actions' holds NaN"),
        (spoil("rewards", lambda x: x * np.nan), "Episode 1: 'rewards' holds NaN"),
        (spoil("terminations", np.ones_like), "'terminations' is true at step 0 of 5"),
        (spoil("truncations", np.ones_like), "'truncations' is true at step 0 of 5"),
        (spoil("infos", lambda _: np.zeros((6, 9)), "goal"), r"'goal' has the shape \(6, 9\)"),
        (spoil("infos", lambda _: np.full((6, 1), 2), "has_goal"), "'has_goal' holds other values"),
    ],
)
def test_unusable_values_of_others_are_named_with_their_episode(tmp_path, change, told):
    space = make_space(STATES)
    episodes = [record_episode(space, length, length) for length in (3, 5)]
    change(episodes[1])
    dataset = write_dataset(tmp_path / "other-v0", space, episodes)
    with pytest.raises(ConfigError, match=told):
        import_minari(dataset, tmp_path / "demos")
    assert not (tmp_path / "demos").exists()


def test_numbers_stand_for_columns_of_one(tmp_path):
    space = make_space({**STATES, "time_left": ()})
    dataset = write_dataset(tmp_path / "other-v0", space, [record_episode(space, 3, 0)])
    import_minari(dataset, tmp_path / "demos")
    (rows,) = open_demonstrations(tmp_path / "demos").shards
    assert rows["time_left"].shape == (3, 1) and rows["time_left"].dtype == torch.float32


def test_an_import_that_fails_leaves_nothing(tmp_path):
    import h5py

    space = make_space(STATES)
    dataset = write_dataset(
        tmp_path / "other-v0", space, [record_episode(space, 3, seed) for seed in range(31)]
    )
    with h5py.File(dataset / "data" / "main_data.hdf5", "a") as file:
        rewards = file["episode_30"]["rewards"][:]
        del file["episode_30"]["rewards"]
    for _ in range(2):
        with pytest.raises(CheckpointError, match="cannot be read"):
            import_minari(dataset, tmp_path / "demos")
        assert not (tmp_path / "demos").exists()
    with h5py.File(dataset / "data" / "main_data.hdf5", "a") as file:
        file["episode_30"]["rewards"] = rewards
    assert import_minari(dataset, tmp_path / "demos")["episodes"] == 31


def test_nothing_is_written_over(demonstrations, tmp_path):
    folder = export_minari(demonstrations, NAME)
    with pytest.raises(ConfigError, match="is there already"):
        export_minari(demonstrations, NAME)
    with pytest.raises(ConfigError, match="is there already"):
        import_minari(NAME, demonstrations.path)
    with pytest.raises(ConfigError, match="no id of a Minari dataset"):
        export_minari(demonstrations, "grasps without number")
    with pytest.raises(CheckpointError, match="minari download torchgrasp/none-v0"):
        import_minari("torchgrasp/none-v0", tmp_path / "none")
    file = folder / "data" / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(CheckpointError, match="cannot be read"):
        import_minari(NAME, tmp_path / "damaged")


def test_the_command_checks_exports_and_imports(demonstrations, tmp_path, capsys):
    path, dataset = str(demonstrations.path), str(tmp_path / "away-v3")
    assert main(["dataset", path, "--export", dataset]) == 0
    told = capsys.readouterr().out
    assert "failed" in told and f"{demonstrations.card['steps']}" in told and "All files are as" in told
    assert main(["dataset", str(tmp_path / "back"), "--import", dataset]) == 0
    assert "mug" in capsys.readouterr().out
    assert minari.MinariDataset(tmp_path / "away-v3" / "data").id == "away-v3"
    (demonstrations.path / "shard_00001" / "rows" / "goal.memmap").write_bytes(b"")
    assert main(["dataset", path]) == 1
    assert "goal.memmap has 0 bytes" in capsys.readouterr().err
    assert main(["dataset", path, "--drop-damaged"]) == 0
    assert "shard_00001 deleted" in capsys.readouterr().out
    assert main(["dataset", path]) == 0


def test_the_command_takes_a_kind_with_an_import_alone(demonstrations, tmp_path, capsys):
    path, dataset = str(demonstrations.path), str(tmp_path / "my-video")
    assert main(["dataset", path, "--export", dataset]) == 0
    assert "my-video" in capsys.readouterr().out
    assert main(["dataset", str(tmp_path / "back"), "--import", dataset, "--kind", "learner"]) == 0
    card = open_demonstrations(tmp_path / "back").card
    assert card["kind"] == card["provenance"]["kind"] == "learner"
    assert card["provenance"]["imported_from"] == "my-video-v0"
    for wrong, told in [
        (["--kind", "learner"], "goes with --import alone"),
        (["--export", ""], "'' is no id"),
    ]:
        assert main(["dataset", path, *wrong]) == 1
        assert told in capsys.readouterr().err
    assert main(["dataset", str(tmp_path / "new"), "--import", ""]) == 1
    assert "'' is no id" in capsys.readouterr().err


def test_a_reader_that_has_had_enough_is_no_error(demonstrations):
    command = [sys.executable, "-m", "torchgrasp", "dataset", str(demonstrations.path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert process.wait(60) == 1 and process.stderr.read() == ""


def test_without_minari_one_line_tells_what_to_install(demonstrations, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "minari", None)
    assert main(["dataset", str(demonstrations.path), "--export", NAME]) == 1
    assert 'pip install "torchgrasp[minari]"' in capsys.readouterr().err


@pytest.fixture
def dataset(tmp_path):
    space = make_space(STATES)
    return write_dataset(tmp_path / "other-v1", space, [record_episode(space, 3, seed) for seed in (0, 1)])


def refuse(dataset, told, tmp_path):
    with pytest.raises((CheckpointError, ConfigError), match=told) as error:
        import_minari(dataset, tmp_path / "imported")
    assert "\n" not in str(error.value) and not (tmp_path / "imported").exists()


def test_hostile_metadata_is_refused(dataset, tmp_path):
    file = dataset / "data" / "metadata.json"
    metadata = json.loads(file.read_text())

    def write(document):
        file.write_text(json.dumps(document))

    def read():
        shutil.rmtree(tmp_path / "demos", ignore_errors=True)
        import_minari(dataset, tmp_path / "demos")

    def free(words):  # what is not read
        return words.startswith(("total_steps", "jpeg_encoding", "dataset_size")) or words.endswith("more")

    assert check_each(metadata, write, read, free=free) > 40
    check_texts(file, read)
    write({**metadata, "observation_space": metadata["observation_space"].replace("20", "2000000000")})
    refuse(dataset, "another shape", tmp_path)


def test_a_dataset_makes_no_environment(dataset, tmp_path):
    """Minari makes that of `env_spec` where a space is missing, whatever function it names."""
    file = dataset / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    del metadata["action_space"]
    spec = {"id": "x-v0", "entry_point": "pathlib:Path.touch", "kwargs": {"self": str(tmp_path / "touched")}}
    file.write_text(json.dumps({**metadata, "env_spec": json.dumps(spec)}))
    refuse(dataset, "lacks action_space", tmp_path)
    assert not (tmp_path / "touched").exists()


def test_an_export_with_a_hostile_card_is_refused(demonstrations, tmp_path):
    file = export_minari(demonstrations, NAME) / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    for change in ({"attempts": 10**30}, {"kind": "none"}, {"provenance": []}, {"wall_seconds": "\x1b[31m"}):
        file.write_text(json.dumps({**metadata, "torchgrasp": {**metadata["torchgrasp"], **change}}))
        refuse(NAME, r"metadata\.json cannot be used \(torchgrasp\.", tmp_path)


def open_hdf5(dataset):
    return pytest.importorskip("h5py").File(dataset / "data" / "main_data.hdf5", "a")


def lie_elsewhere(group, secret):
    del group["rewards"]
    group.create_dataset("rewards", (3,), "f8", external=[(str(secret), 0, 24)])


def link_elsewhere(group, secret):
    import h5py

    group["infos"] = h5py.ExternalLink(str(secret), "/")


def link_itself(group, _):
    group["observations"]["again"] = group["observations"]


def link_softly(group, _):
    import h5py

    group["infos"] = h5py.SoftLink("/episode_0")


def claim_too_much(group, _):
    del group["rewards"]
    group.create_dataset("rewards", (10**12,), "f8", chunks=(1000,))


def pad_with_zeros(group, _):
    del group["rewards"]
    group.create_dataset("rewards", (10**9,), "f8", chunks=(10**6,), compression="gzip")
    group["rewards"][:1000] = 1.0


def hold_texts(group, _):
    group["infos/words"] = ["any", "length"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lie_elsewhere, "rewards lies in other files"),
        (link_elsewhere, "infos is a link to elsewhere"),
        (link_softly, "infos is a link to elsewhere"),
        (link_itself, "again is there under another name"),
        (claim_too_much, "would take 8000000000000 bytes, 0 are stored"),
        (pad_with_zeros, "would take 8000000000 bytes"),
        (hold_texts, "words holds values of any length"),
    ],
)
def test_hdf5_that_reaches_out_or_claims_too_much_is_refused(dataset, tmp_path, change, told):
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(100))
    with open_hdf5(dataset) as file:
        change(file["episode_1"], secret)
    refuse(dataset, told, tmp_path)


def test_other_episodes_than_metadata_tells_are_refused(dataset, tmp_path):
    file = dataset / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    for number in (1, 3, 2**50):
        file.write_text(json.dumps({**metadata, "total_episodes": number}))
        refuse(dataset, "holds 2 episodes", tmp_path)


@pytest.mark.parametrize(("name", "value"), [("seed", 2.0**70), ("seed", "x"), ("options", 3)])
def test_attributes_of_other_kinds_are_refused(dataset, tmp_path, name, value):
    with open_hdf5(dataset) as file:
        file["episode_1"].attrs[name] = value
    refuse(dataset, "Episode 1 has|cannot be read", tmp_path)


def test_a_damaged_hdf5_file_is_one_line(dataset, tmp_path):
    file = dataset / "data" / "main_data.hdf5"
    content = file.read_bytes()
    for place in range(0, len(content), len(content) // 40):
        changed = bytearray(content)
        changed[place] ^= 0xFF
        file.write_bytes(changed)
        shutil.rmtree(tmp_path / "demos", ignore_errors=True)
        with contextlib.suppress(CheckpointError, ConfigError):
            import_minari(dataset, tmp_path / "demos")
