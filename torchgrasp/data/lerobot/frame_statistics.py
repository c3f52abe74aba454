"""What LeRobot keeps of each feature to normalise by: extremes, mean, deviation, quantiles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from torchgrasp.data.lerobot.features import Feature

# A cloud's points come in no order: statistics of its n-th point would tell nothing, and take more room
# than the cloud.
_MOST_NUMBERS = 64
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_CHANNELS = 3
_LARGEST = float(np.finfo(np.float32).max)

Statistics = dict[str, dict[str, Any]]


def measure_frames(frames: TensorDictBase, features: Sequence[Feature]) -> Statistics:
    """Feature -> statistics of one episode's frames (T), as LeRobot computes them of every frame.

    Pictures have them by channel, (C, 1, 1), in [0, 1], depth in metres; features of more than 64
    numbers have none.
    """
    measured: Statistics = {}
    for feature in features:
        values: Any = frames[feature.key]
        if feature.picture is not None:
            channels = _CHANNELS if feature.picture == "rgb" else 1
            scale = 255.0 if feature.picture == "rgb" else 1.0
            told = _measure(values.double().reshape(-1, channels).numpy() / scale)
            measured[feature.name] = {name: each.reshape(channels, 1, 1) for name, each in told.items()}
            measured[feature.name]["count"] = np.array([len(frames)])
        elif 0 < math.prod(feature.shape) <= _MOST_NUMBERS:
            table = values.double().reshape(len(frames), -1).numpy()
            told = _measure(table)
            shape = feature.shape or (1,)
            measured[feature.name] = {name: each.reshape(shape) for name, each in told.items()}
            measured[feature.name]["count"] = np.array([len(frames)])
    return measured


def _measure(table: Any) -> dict[str, Any]:
    """Of each column of (R, C)."""
    # NaN, as of actions that were not tried, would make JSON that nobody reads.
    table = np.nan_to_num(table, nan=0.0, posinf=_LARGEST, neginf=-_LARGEST)
    quantiles = np.quantile(table, list(_QUANTILES.values()), axis=0)
    return {
        "min": table.min(axis=0),
        "max": table.max(axis=0),
        "mean": table.mean(axis=0),
        "std": table.std(axis=0),
        **dict(zip(_QUANTILES, quantiles, strict=True)),
    }


def join_statistics(all_of: Statistics, more: Statistics) -> Statistics:
    """Statistics of the frames of both; quantiles become bounds, the lower ones' least, the upper's most."""
    return {name: _join(all_of[name], each) if name in all_of else each for name, each in more.items()}


def _join(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    count = one["count"] + other["count"]
    share = other["count"][0] / count[0]
    step = other["mean"] - one["mean"]
    variance = (1 - share) * one["std"] ** 2 + share * other["std"] ** 2 + share * (1 - share) * step**2
    joined = {"min": np.minimum(one["min"], other["min"]), "max": np.maximum(one["max"], other["max"])}
    joined |= {"mean": one["mean"] + share * step, "std": np.sqrt(variance), "count": count}
    for name, rank in _QUANTILES.items():
        joined[name] = (np.minimum if rank <= 0.5 else np.maximum)(one[name], other[name])
    return joined


def list_statistics(statistics: Statistics) -> dict[str, dict[str, Any]]:
    """The same in plain lists."""
    return {name: {key: each.tolist() for key, each in told.items()} for name, told in statistics.items()}
