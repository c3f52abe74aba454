"""Which camera a transform sees through, in configurations of today and of older files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from torchgrasp.intrinsics import CameraIntrinsics


def _which_camera(transform: Mapping[str, Any]) -> str:
    """The part of the configuration with the camera whose pictures a transform reads."""
    return "overhead" if transform.get("camera") == "overhead" else "camera"


def name_lenses(config: dict[str, Any]) -> dict[str, Any]:
    """A configuration whose transforms name their camera's intrinsics, where an older file has the `fov`.

    A field of view of another size than the camera's stays as it is.
    """
    transforms = dict(config.get("transforms") or {})
    for name, transform in transforms.items():
        theirs = (config.get(_which_camera(transform)) or {}).get("intrinsics") or {}
        if "fov" in transform and transform["fov"] == theirs.get("fov"):
            others = {option: value for option, value in transform.items() if option != "fov"}
            transforms[name] = {**others, "intrinsics": theirs}
    return {**config, "transforms": transforms} if transforms else config


def follow_cameras(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration with transforms whose intrinsics, where they have a camera's, refer to that again."""
    followed = {}
    for name, transform in (config.get("transforms") or {}).items():
        camera = _which_camera(transform)
        theirs = (config.get(camera) or {}).get("intrinsics")
        follows = theirs is not None and transform.get("intrinsics") == theirs
        reference = f"${{{camera}.intrinsics}}"
        followed[name] = {**transform, "intrinsics": reference} if follows else transform
    return {**config, "transforms": followed}


def describe_lens(intrinsics: CameraIntrinsics) -> dict[str, Any]:
    """Intrinsics as a configuration names them."""
    numbers = asdict(intrinsics).items()
    plain = {name: each.item() if isinstance(each, np.generic) else each for name, each in numbers}
    return {"_target_": f"{CameraIntrinsics.__module__}.CameraIntrinsics", **plain}
