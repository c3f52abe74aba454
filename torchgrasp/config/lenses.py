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
    transforms = config.get("transforms")
    if not isinstance(transforms, Mapping):
        return config
    named = {name: _name_lens(transform, config) for name, transform in transforms.items()}
    return {**config, "transforms": named}


def _name_lens(transform: Any, config: Mapping[str, Any]) -> Any:
    if not isinstance(transform, Mapping) or "fov" not in transform:
        return transform
    camera = config.get(_which_camera(transform))
    theirs = camera.get("intrinsics") if isinstance(camera, Mapping) else None
    if not isinstance(theirs, Mapping) or transform["fov"] != theirs.get("fov"):
        return transform
    others = {option: value for option, value in transform.items() if option != "fov"}
    return {**others, "intrinsics": theirs}


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
