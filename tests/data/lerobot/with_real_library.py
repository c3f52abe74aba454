"""An export and a dataset of LeRobot's own, by LeRobot itself, in an environment of its own.

    python -m venv real && real/bin/pip install "lerobot[dataset]" diffusers einops
    python -m torchgrasp dataset demos --format lerobot --export exported
    real/bin/python tests/data/lerobot/with_real_library.py demos exported theirs
    python -m torchgrasp dataset again --format lerobot --import theirs

It imports nothing of torchgrasp: what it expects it reads from the mapped files of `demos` by numpy.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from torch.utils.data import DataLoader

DEPTH, MASK = "observation.images.depth", "observation.images.mask"
OUR_TYPES = {"torch.float32": "<f4", "torch.float16": "<f2", "torch.bool": "?", "torch.int64": "<i8"}


def read_rows(demos: Path) -> dict[tuple[str, ...], np.ndarray]:
    """Every column of all shards, stubs left out, from the files of TensorDict.memmap."""
    shards = [read_folder(shard / "rows") for shard in sorted(demos.glob("shard_*"))]
    rows = {key: np.concatenate([shard[key] for shard in shards]) for key in shards[0]}
    steps = ~rows.pop(("stub",))[:, 0]
    return {key: values[steps] for key, values in rows.items()}


def read_folder(folder: Path, above: tuple[str, ...] = ()) -> dict[tuple[str, ...], np.ndarray]:
    told = json.loads((folder / "meta.json").read_text())
    rows = {}
    for name, entry in told.items():
        if isinstance(entry, dict) and "shape" in entry and "dtype" in entry:
            flat = np.fromfile(folder / f"{name}.memmap", OUR_TYPES[entry["dtype"]])
            rows[*above, name] = flat.reshape(entry["shape"])
    for below in (each for each in folder.iterdir() if each.is_dir()):
        rows |= read_folder(below, (*above, below.name))
    return rows


def compare_export(demos: Path, exported: Path) -> LeRobotDataset:
    """Every value that LeRobot's loader gives of the export equals the one on disk, bit for bit."""
    rows = read_rows(demos)
    told = json.loads((exported / "meta" / "torchgrasp.json").read_text())["columns"]
    names = {tuple(column["key"]): name for name, column in told.items()}
    assert set(names) == set(rows), set(names) ^ set(rows)
    start = time.monotonic()
    dataset = LeRobotDataset("torchgrasp/check", root=exported, depth_output_unit="m")
    opened, start, number = time.monotonic() - start, time.monotonic(), 0
    for batch in DataLoader(dataset, batch_size=32):
        size = len(batch["index"])
        for key, name in names.items():
            expected = torch.from_numpy(rows[key][number : number + size])
            found = batch[name]
            found = found.movedim(1, -1).squeeze(-1) if name in (DEPTH, MASK) else found
            found = found.reshape(expected.shape)
            assert torch.equal(found.to(torch.float64), expected.to(torch.float64)), name
        number += size
    seconds = time.monotonic() - start
    assert number == len(rows["action",]) == dataset.num_frames
    print(f"export: {dataset.num_episodes} episodes, {number} frames, {len(names)} columns equal bit for bit")
    print(f"        opened in {opened:.1f} s, {1e3 * seconds / number:.1f} ms a frame")
    return dataset


def train_act(exported: Path) -> None:
    """One step of LeRobot's ACT on pictures of depth, the joints and chunks of actions."""
    period = 0.15
    chunk = 4
    dataset = LeRobotDataset(
        "torchgrasp/check",
        root=exported,
        depth_output_unit="m",
        delta_timestamps={"action": [period * step for step in range(chunk)]},
    )
    batch = next(iter(DataLoader(dataset, batch_size=8, shuffle=True)))
    batch[DEPTH] = batch[DEPTH].expand(-1, 3, -1, -1)  # its ResNet reads three channels
    size = tuple(batch[DEPTH].shape[1:])
    config = ACTConfig(
        input_features={
            DEPTH: PolicyFeature(FeatureType.VISUAL, size),
            "observation.state": PolicyFeature(FeatureType.STATE, (9,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (6,))},
        chunk_size=chunk,
        n_action_steps=chunk,
        dim_model=64,
        n_heads=2,
        dim_feedforward=64,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    policy = ACTPolicy(config)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-4)
    losses = []
    for _ in range(5):
        loss, _ = policy.forward(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.isfinite(losses).all() and losses[-1] < losses[0], losses
    print(f"ACT: loss {losses[0]:.3f}, after five steps on one batch {losses[-1]:.3f}")


def write_theirs(dataset: LeRobotDataset, theirs: Path) -> None:
    """A dataset that LeRobot's own writer makes, of the frames of the export."""
    height, width = dataset.meta.features[DEPTH]["shape"][:2]
    axes = ["height", "width", "channels"]
    points = tuple(dataset.meta.features["observation.points"]["shape"])
    features = {
        DEPTH: {"dtype": "image", "shape": (height, width, 1), "names": axes, "info": {"is_depth_map": True}},
        "observation.images.rgb": {"dtype": "image", "shape": (height, width, 3), "names": axes},
        "observation.state": {"dtype": "float32", "shape": (9,), "names": None},
        "observation.T_base_ee": {"dtype": "float32", "shape": (4, 4), "names": None},
        "observation.T_base_camera": {"dtype": "float32", "shape": (4, 4), "names": None},
        "observation.points": {"dtype": "float32", "shape": points, "names": None},
        "action": {"dtype": "float32", "shape": (6,), "names": None},
        "next.reward": {"dtype": "float32", "shape": (1,), "names": None},
    }
    new = LeRobotDataset.create("torchgrasp/theirs", fps=7, features=features, root=theirs, use_videos=False)
    for episode in range(3):
        told = dataset.meta.episodes[episode]
        for index in range(told["dataset_from_index"], told["dataset_to_index"]):
            frame = dataset[index]
            mask = frame[MASK][0].numpy()
            values = {name: frame[name].numpy() for name in features if name in frame and name != DEPTH}
            values["next.reward"] = values["next.reward"].reshape(1)
            values[DEPTH] = frame[DEPTH].numpy().transpose(1, 2, 0)
            values["observation.images.rgb"] = np.repeat(np.uint8(255 * mask)[..., None], 3, axis=2)
            new.add_frame({**values, "task": frame["task"]})
        new.save_episode()
    new.finalize()
    print(f"theirs: {new.meta.total_episodes} episodes, {new.meta.total_frames} frames by LeRobot's writer")


if __name__ == "__main__":
    ours, exported, theirs = map(Path, sys.argv[1:])
    print(", ".join(f"{name} {version(name)}" for name in ("lerobot", "torch", "datasets", "pyarrow")))
    whole = compare_export(ours, exported)
    train_act(exported)
    write_theirs(whole, theirs)
