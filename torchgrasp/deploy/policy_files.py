"""What is written beside an exported network: its settings as JSON, and the runner that needs no torch."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

from torchgrasp.config.trained_policy import TrainedPolicy
from torchgrasp.config.trained_view import check_action_space, choose_transforms, training_lens
from torchgrasp.data.files import write_text_atomically, writing
from torchgrasp.deploy import runner
from torchgrasp.deploy.arguments import HIGHEST, LOWEST
from torchgrasp.deploy.export_network import list_inputs, list_outputs, write_onnx, write_torch
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND, gripper_control_points
from torchgrasp.objects.gripper import hand_boxes
from torchgrasp.sim.control import TABLE_GUARD
from torchgrasp.sim.kinematics import hand_in_link7, joint_frames
from torchgrasp.transforms import (
    AggregatePoints,
    AppendGripperPoints,
    DepthToPoints,
    SamplePoints,
    TablePlane,
    WristAngle,
)

FORMATS = ("onnx", "torch_export")
_ENDINGS = {"onnx": ".onnx", "torch_export": ".pt2"}
# What the runner does itself, and the options of it that it reads.
_OPTIONS: dict[type, tuple[str, ...]] = {
    DepthToPoints: (),
    AggregatePoints: ("alpha", "max_points", "carve", "seed"),
    SamplePoints: ("num_points", "seed"),
    AppendGripperPoints: (),
    TablePlane: (),
    WristAngle: (),
}


def export_policy(policy: TrainedPolicy, *, format: str = "onnx", output: str | Path) -> list[Path]:
    """Write a policy for machines without torchgrasp.

    With ``onnx`` three files: the network, beside it its settings (`.json`) and `grasp_policy.py`, which goes
    the whole way from depth, mask and joints to the hand's next pose with numpy and onnxruntime alone. With
    ``torch_export`` the network alone, for `torch.export.load`.

    Args:
        policy: of `load_policy`.
        format: ``onnx`` or ``torch_export``.
        output: the network's file, with the ending `.onnx` or `.pt2`; files of before are replaced.

    Returns:
        The files written.

    Raises:
        ConfigError: where the policy, or a transform of it, cannot be exported, and where `format` is unknown
            or `output` ends otherwise; the message names it.
        MissingPackageError: where `onnx` is asked for without the extra `export`.
        StorageError: where a file cannot be written, which leaves the one of before as it was.

    Example:
        >>> import tempfile, torchgrasp
        >>> policy = torchgrasp.load_policy("pretrained")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     [file.name for file in export_policy(policy, output=f"{folder}/policy.onnx")]
        ['policy.onnx', 'policy.json', 'grasp_policy.py']
    """
    if format not in FORMATS:
        raise ConfigError(f"format={format!r} is unknown: give {' or '.join(FORMATS)}.")
    file = Path(output)
    if file.suffix != _ENDINGS[format]:
        raise ConfigError(f"output={file} does not end with {_ENDINGS[format]}: format={format} writes that.")
    with writing(file.parent):
        file.parent.mkdir(parents=True, exist_ok=True)
    if format == "torch_export":
        write_torch(policy, file)
        return [file]
    settings = describe_policy(policy, network=file.name)
    write_onnx(policy, file)
    texts = {
        file.with_suffix(".json"): json.dumps(settings, indent=1) + "\n",
        file.with_name("grasp_policy.py"): inspect.getsource(runner),
    }
    for each, text in texts.items():
        write_text_atomically(each, text)
    return [file, *texts]


def describe_policy(policy: TrainedPolicy, *, network: str) -> dict[str, Any]:
    """What the runner is told of a policy whose network lies in the file of that name.

    Raises:
        ConfigError: where the runner has no way to do a transform, or its actions are no hand poses.
    """
    check_action_space(policy)
    transforms = [_describe_transform(made, node) for made, node in choose_transforms(policy)]
    lens = training_lens(policy)
    (fx, fy), (cx, cy) = lens.focal.tolist(), (lens.centre - 0.5).tolist()
    camera = {"width": lens.width, "height": lens.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    return {
        "format": runner.FORMAT,
        "network": network,
        "inputs": list_inputs(policy),
        "outputs": list_outputs(policy),
        "horizon": policy.horizon,
        "camera": {**camera, "near": lens.near, "far": lens.far},
        "transforms": transforms,
        "action_bound": list(ACTION_BOUND),
        "table_guard": TABLE_GUARD,
        "hand_boxes": hand_boxes(),
        "arm": {
            "joints": joint_frames().tolist(),
            "hand": hand_in_link7().tolist(),
            "lowest": LOWEST.tolist(),
            "highest": HIGHEST.tolist(),
        },
    }


def _describe_transform(made: type, node: dict[str, Any]) -> dict[str, Any]:
    if made not in _OPTIONS or node.get("camera", "wrist") != "wrist":
        names = ", ".join(each.__name__ for each in _OPTIONS)
        which = f"{made.__name__} of the overhead camera" if made in _OPTIONS else made.__name__
        raise ConfigError(
            f"policy reads what the transform {which} makes, which the exported file cannot: it has {names}. "
            "format=torch_export writes the network alone."
        )
    options = {name: each.default for name, each in inspect.signature(made).parameters.items()} | node
    told = {name: options[name] for name in _OPTIONS[made]}
    if made is AppendGripperPoints:
        points = gripper_control_points().tolist()
        told["marked"] = [[*point, 1.0] for point in points]
    return {"name": made.__name__, **told}
