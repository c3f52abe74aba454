import copy
import json
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from collections import OrderedDict

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from tests.hostile_values import check_each, check_texts
from torchgrasp.data import CompactTransitions, MixtureReplayBuffer, MixtureSampler
from torchgrasp.data.files import describe_file
from torchgrasp.errors import CheckpointError
from torchgrasp.runs.checkpoint import checkpoint_exists, load_checkpoint, save_checkpoint
from torchgrasp.runs.seeding import get_rng_state, seed_everything, set_rng_state


def equal(a, b):
    """Equality down to types, dtypes and bits."""
    if type(a) is not type(b):
        return False
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and a.shape == b.shape and torch.equal(a, b)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, TensorDict):
        return a.shape == b.shape and equal(dict(a.items()), dict(b.items()))
    if isinstance(a, dict):
        return list(a) == list(b) and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(equal, a, b))
    return a == b or (a != a and b != b)


TREES = {
    "numbers": {"i": 3, "f": 0.1, "nan": float("nan"), "inf": -float("inf"), "big": 2**127, "none": None},
    "flags": {"true": True, "one": 1, "text": 'a"b\n', "bytes": b"\x00\xff"},
    "sequences": {"list": [1, [2.5, ()]], "tuple": (1, None, (2,)), "size": torch.Size([3, 4])},
    "keys": {0: "int", "0": "str", (1, "a"): "tuple", None: "none", True: "yes"},
    "ordered": OrderedDict([("b", 1), ("a", torch.zeros(2))]),
    "tag": {"$": "looks like a tag", "x": 1},
    "dtypes": {
        str(d): torch.arange(3).to(d) for d in (torch.bfloat16, torch.float64, torch.bool, torch.uint8)
    },
    "shapes": {
        "scalar": torch.tensor(3.0),
        "empty": torch.zeros(0, 4),
        "strided": torch.arange(6).view(2, 3).T,
    },
    "clash": {"a.b": torch.zeros(1), "a": {"b": torch.ones(1)}},
    "numpy": {"uint32": np.arange(4, dtype=np.uint32), "scalar": np.float32(0.1), "flag": np.bool_(True)},
    "types": {"device": torch.device("cuda:1"), "dtype": torch.bfloat16},
    "tensordict": TensorDict({"x": torch.ones(2, 3), "y": {"z": torch.zeros(2, dtype=torch.int64)}}, [2]),
}


@pytest.mark.parametrize("name", TREES)
def test_state_comes_back_exactly(name, tmp_path):
    save_checkpoint(tmp_path / "c", {"state": TREES[name]})
    loaded = load_checkpoint(tmp_path / "c")["state"]
    assert equal(loaded, TREES[name])


def test_shared_memory_is_saved_for_each(tmp_path):
    whole = torch.arange(10)
    save_checkpoint(tmp_path / "c", {"state": {"whole": whole, "again": whole, "part": whole[3:]}})
    loaded = load_checkpoint(tmp_path / "c")["state"]
    assert equal(loaded, {"whole": whole, "again": whole, "part": whole[3:]})


def test_random_generators_go_on_alike(tmp_path):
    generator = seed_everything(7)
    torch.randn(3, generator=generator)
    state = {
        "rng": get_rng_state(),
        "own": generator.get_state(),
        "pcg": np.random.default_rng(3).bit_generator.state,
    }
    save_checkpoint(tmp_path / "c", state)
    expected = (random.random(), np.random.rand(), torch.rand(2), torch.rand(2, generator=generator))
    loaded = load_checkpoint(tmp_path / "c")
    set_rng_state(loaded["rng"])
    generator.set_state(loaded["own"])
    assert equal(
        (random.random(), np.random.rand(), torch.rand(2), torch.rand(2, generator=generator)), expected
    )
    assert loaded["pcg"] == state["pcg"]


def make_training(seed):
    torch.manual_seed(seed)
    net = nn.Sequential(nn.Linear(4, 16), nn.ReLU(), nn.BatchNorm1d(16), nn.Linear(16, 1))
    optimizer = torch.optim.Adam(net.parameters(), lr=1e-2)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: 0.97**step)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(200),
        sampler=MixtureSampler({"a": 0.7, "b": 0.3}),
        batch_size=10,
        generator=torch.Generator().manual_seed(seed),
    )
    return {"net": net, "optimizer": optimizer, "schedule": schedule, "buffer": buffer}


def train(parts, num_steps):
    for _ in range(num_steps):
        x = torch.randn(4, 4)
        source = torch.randint(2, (4,))
        parts["buffer"].extend(TensorDict({"x": x, "y": x.sum(-1, keepdim=True), "source": source}, [4]))
        batch = parts["buffer"].sample()
        parts["optimizer"].zero_grad()
        (parts["net"](batch["x"]) - batch["y"]).square().mean().backward()
        parts["optimizer"].step()
        parts["schedule"].step()


def test_resumed_training_equals_training_that_never_stopped(tmp_path):
    whole = make_training(0)
    seed_everything(1)
    train(whole, 20)
    state = {name: part.state_dict() for name, part in whole.items()}
    save_checkpoint(tmp_path / "c", {**state, "rng": get_rng_state()})
    train(whole, 20)
    resumed = make_training(5)
    train(resumed, 3)
    loaded = load_checkpoint(tmp_path / "c")
    for name, part in resumed.items():
        part.load_state_dict(loaded[name])
    set_rng_state(loaded["rng"])
    train(resumed, 20)
    for name in ("net", "optimizer", "schedule"):
        assert equal(resumed[name].state_dict(), whole[name].state_dict())


def test_a_replay_buffer_is_resumed_from_its_checkpoint(tmp_path):
    steps, generator = torch.arange(30), torch.Generator().manual_seed(0)
    done = {"done": (steps % 7 == 6)[:, None], "terminated": (steps % 7 == 6)[:, None]}
    state = {"points": torch.rand(30, 16, 3, generator=generator), "time_left": steps[:, None].float()}
    following = {**state, **done, "reward": torch.zeros(30, 1)}
    rollout = TensorDict({**state, "action": torch.rand(30, 6, generator=generator), "next": following}, [30])
    buffers = [
        MixtureReplayBuffer(
            {"online": 50, "expert": 40},
            {"online": 0.7, "expert": 0.3},
            batch_size=10,
            seed=seed,
            codec=CompactTransitions(gripper_points=False),
        )
        for seed in (0, 1)
    ]
    for source in ("online", "expert", "online"):
        buffers[0].extend(rollout, source=source)
    buffers[0].sample()
    save_checkpoint(tmp_path / "c", {"replay": buffers[0].state_dict()})
    buffers[1].load_state_dict(load_checkpoint(tmp_path / "c")["replay"])
    for _ in range(3):
        assert (buffers[0].sample() == buffers[1].sample()).all()
        for buffer in buffers:
            buffer.extend(rollout)


def test_saving_leaves_the_state_alone(tmp_path):
    parts = make_training(0)
    train(parts, 5)
    before = copy.deepcopy(parts["optimizer"].state_dict())
    save_checkpoint(tmp_path / "c", {"optimizer": parts["optimizer"].state_dict()})
    assert equal(parts["optimizer"].state_dict(), before)


def test_damage_is_found_and_told(tmp_path):
    path = tmp_path / "c"
    with pytest.raises(CheckpointError, match="no checkpoint"):
        load_checkpoint(path)

    def save():
        save_checkpoint(path, {"net": {"w": torch.arange(1000.0)}, "step": 3})
        return path / "net.safetensors"

    file = save()
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(CheckpointError, match="bytes instead of"):
        load_checkpoint(path)
    file = save()
    content = bytearray(file.read_bytes())
    content[-100] ^= 1
    file.write_bytes(content)
    with pytest.raises(CheckpointError, match="checksum"):
        load_checkpoint(path)
    save().unlink()
    with pytest.raises(CheckpointError, match=r"net\.safetensors is missing.*restore"):
        load_checkpoint(path)
    save()
    (path / "step.json").write_text("4")
    with pytest.raises(CheckpointError, match=r"step\.json was changed"):
        load_checkpoint(path)
    save()
    (path / "manifest.json").write_text('{"format": 1')
    with pytest.raises(CheckpointError, match=r"manifest\.json cannot be used"):
        load_checkpoint(path)
    save()
    assert equal(load_checkpoint(path)["step"], 3)


def test_what_would_need_pickle_is_refused_by_name(tmp_path):
    save_checkpoint(tmp_path / "c", {"step": 1})
    with pytest.raises(CheckpointError, match=r"hooks\.0 is a function"):
        save_checkpoint(tmp_path / "c", {"step": 2, "net": {"hooks": [lambda: 0]}})
    assert load_checkpoint(tmp_path / "c") == {"step": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["c"]


def wait_for(condition, *, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.0005)


def test_a_checkpoint_survives_a_kill_in_the_middle_of_the_next(tmp_path):
    path = tmp_path / "checkpoint"
    save_checkpoint(path, {"step": 0, "w": torch.zeros(300_000)})
    script = f"""
        import itertools, torch
        from torchgrasp.runs.checkpoint import save_checkpoint
        for step in itertools.count(1):
            save_checkpoint({str(path)!r}, {{"step": step, "w": torch.full((300_000,), float(step))}})
    """
    child = subprocess.Popen([sys.executable, "-W", "ignore", "-c", textwrap.dedent(script)])
    wait_for(lambda: load_checkpoint(path)["step"] >= 2)  # read while it is being replaced, again and again
    wait_for((tmp_path / ".checkpoint.new" / "w.safetensors").exists)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    loaded = load_checkpoint(path)
    assert loaded["step"] >= 2
    assert torch.equal(loaded["w"], torch.full((300_000,), float(loaded["step"])))


@pytest.mark.parametrize("killed_at", ["while writing", "between the renames"])
def test_the_old_checkpoint_is_found_wherever_the_kill_falls(tmp_path, killed_at):
    path = tmp_path / "checkpoint"
    save_checkpoint(path, {"step": 1})
    (tmp_path / ".checkpoint.new").mkdir()
    (tmp_path / ".checkpoint.new" / "step.json").write_text("2")
    if killed_at == "between the renames":
        path.rename(tmp_path / ".checkpoint.old")
    assert checkpoint_exists(tmp_path)
    assert load_checkpoint(path) == {"step": 1}
    save_checkpoint(path, {"step": 3})
    assert load_checkpoint(path) == {"step": 3}
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint"]


STATE = {
    "learner": {
        "net": OrderedDict([("w", torch.zeros(2, 3))]),
        "groups": [{"lr": 0.1, "betas": (0.9, 0.99)}],
    },
    "random": {"numpy": np.arange(4, dtype=np.uint32), "python": (3, (1, 2), None), "cuda": []},
    "progress": {
        "iteration": 3,
        "results": {"before": {"rate": 0.5}},
        "recent": [True, False],
    },
    "kinds": {"size": torch.Size([2]), "dtype": torch.bool, "scalar": np.float32(0.5), "bytes": b"x"},
    "steps": {0: TensorDict({"x": torch.zeros(2)}, [2])},
}
FRESH = copy.deepcopy(STATE) | {"progress": {"iteration": 0, "results": {}, "recent": []}}


def renew(path):
    """Make the manifest tell of the files as they are now."""
    manifest = json.loads((path / "manifest.json").read_text())
    files = {name: describe_file(path / name) for name in manifest["files"]}
    (path / "manifest.json").write_text(json.dumps({**manifest, "files": files}))


def test_a_hostile_manifest_is_refused(tmp_path):
    path = tmp_path / "c"
    save_checkpoint(path, STATE)
    file = path / "manifest.json"
    manifest = json.loads(file.read_text())

    def write(document):
        file.write_text(json.dumps(document))

    assert check_each(manifest, write, lambda: load_checkpoint(path), free=lambda _: False) > 200
    for name in ("../c/step.json", "/etc/passwd", "a" * 300, "step\0.json", "\x1b[31m.json"):
        write({**manifest, "files": {**manifest["files"], name: {"bytes": 1, "crc32": 1}}})
        with pytest.raises(CheckpointError, match=r"manifest\.json cannot be used") as error:
            load_checkpoint(path)
        assert str(error.value).isprintable()
        write({**manifest, "entries": [*manifest["entries"], name]})
        with pytest.raises(CheckpointError, match=r"manifest\.json cannot be used"):
            load_checkpoint(path)
    check_texts(file, lambda: load_checkpoint(path))


@pytest.mark.parametrize("name", STATE)
def test_hostile_states_with_right_checksums_are_refused(name, tmp_path):
    path = tmp_path / "c"
    save_checkpoint(path, STATE)
    file = path / f"{name}.json"

    def write(document):
        file.write_text(json.dumps(document))
        renew(path)

    def free(words):
        # Results are any table, there may be none yet, and what was None before a first step may be a number.
        empty = ("recent: list", "recent.0: left out", "recent.1: left out", "python.items.2: 1e23")
        return words.startswith(("results", *empty))

    tree = json.loads(file.read_text())
    assert check_each(tree, write, lambda: load_checkpoint(path, like=FRESH), free=free) > 10


def test_a_state_is_of_the_kinds_of_that_which_it_replaces(tmp_path):
    save_checkpoint(tmp_path / "c", STATE)
    assert equal(load_checkpoint(tmp_path / "c", like=FRESH), load_checkpoint(tmp_path / "c"))
    for other, told in [
        ({**FRESH, "more": 1}, "more"),
        ({**FRESH, "progress": {**FRESH["progress"], "iteration": 0.5}}, r"progress\.iteration is 3"),
        ({**FRESH, "learner": {**FRESH["learner"], "net": {}}}, r"learner\.net"),
        ({**FRESH, "random": {**FRESH["random"], "numpy": np.arange(4.0)}}, r"random\.numpy is uint32"),
    ]:
        with pytest.raises(CheckpointError, match=f"another configuration.*{told}"):
            load_checkpoint(tmp_path / "c", like=other)


def test_what_could_not_be_read_again_is_not_written(tmp_path):
    save_checkpoint(tmp_path / "c", {"step": 1})
    deep = []
    for _ in range(100):
        deep = [deep]
    with pytest.raises(CheckpointError, match="nested more than"):
        save_checkpoint(tmp_path / "c", {"step": deep})
    assert load_checkpoint(tmp_path / "c") == {"step": 1}


def test_tensors_that_no_state_names_are_told(tmp_path):
    path = tmp_path / "c"
    save_checkpoint(path, {"net": {"w": torch.zeros(2)}, "step": 3})
    (path / "step.safetensors").write_bytes((path / "net.safetensors").read_bytes())
    with pytest.raises(CheckpointError, match=r"step\.safetensors is no part"):
        load_checkpoint(path)
    (path / "step.safetensors").unlink()
    (path / "net.json").write_text("{}")
    renew(path)
    with pytest.raises(CheckpointError, match="nothing refers to its tensor 'w'"):
        load_checkpoint(path)
