"""``torchgrasp export``: a trained policy as files for machines without torchgrasp, or without torch."""

from __future__ import annotations

import argparse

from torchgrasp.errors import ConfigError

HELP = "write a trained policy for machines without torchgrasp"
_OPTIONS = {
    "policy": "pretrained (the default), a run directory or a weights file",
    "format": "onnx (the default): network, settings and a runner that needs numpy and onnxruntime alone; or "
    "torch_export: the network for torch.export.load",
    "output": "the network's file; policy.onnx or policy.pt2 by default",
    "trust": "packages, by commas, besides torchgrasp and torchrl whose classes a weights file may name",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command, written as those of recipes."""
    told = "; ".join(f"{name}=... {words}" for name, words in _OPTIONS.items())
    parser.add_argument("options", nargs="*", metavar="name=value", help=told)


def run(args: argparse.Namespace) -> int:
    """Write the files, and name them."""
    from torchgrasp.config.trained_policy import load_policy
    from torchgrasp.config.weights_files import check_weights
    from torchgrasp.deploy.policy_files import FORMATS, export_policy

    options = _read_options(args.options)
    kind = options.get("format", FORMATS[0])
    ending = "pt2" if kind == "torch_export" else "onnx"
    trust = [each for each in options.get("trust", "").split(",") if each]
    source = options.get("policy", "pretrained")
    check_weights("policy", source)
    policy = load_policy(source, trust=trust)
    for file in export_policy(policy, format=kind, output=options.get("output", f"policy.{ending}")):
        print(f"Written to {file}")
    return 0


def _read_options(given: list[str]) -> dict[str, str]:
    options = {}
    for each in given:
        name, equals, value = each.partition("=")
        if not equals or name not in _OPTIONS or not (value or name == "trust"):
            raise ConfigError(f"{each!r} is no option: give {', '.join(f'{name}=...' for name in _OPTIONS)}.")
        if name in options:
            raise ConfigError(f"{name} is given twice: give it once.")
        options[name] = value
    return options
