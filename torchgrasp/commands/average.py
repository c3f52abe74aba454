"""``torchgrasp average``: one policy of several that were trained on from one start, or of reflections."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "average the weights of policies that were trained on from one another, or from one start"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The policies, and where their mean goes."""
    parser.add_argument(
        "policies", nargs="+", help="run directories, weights files or pretrained; two or more"
    )
    parser.add_argument(
        "--mirrored",
        action="store_true",
        help="act by the mean over the hand's reflections as well; one policy is enough then",
    )
    parser.add_argument("--output", default="policy.safetensors", help="the weights file to write")


def run(args: argparse.Namespace) -> int:
    """Write the mean, and name it."""
    from torchgrasp.config.weights_files import check_weights, weights_file
    from torchgrasp.runs.averaged_weights import average_weights

    for name in args.policies:
        check_weights("policy", name)
    files = [weights_file(Path(name)) for name in args.policies]
    _check_same_task(files)
    names = average_weights(files, Path(args.output), mirrored=args.mirrored)
    print(f"Written to {args.output}: {', '.join(names)} of {len(args.policies)} policies")
    return 0


def _check_same_task(files: list[Path]) -> None:
    """Refuse policies that see or move otherwise than the first."""
    from torchgrasp.config.provenance import find_differing
    from torchgrasp.errors import ConfigError
    from torchgrasp.runs import load_weights

    configs = [load_weights(file)[1] for file in files]
    first, *others = [
        {**each, **env} if isinstance(env := each.get("env"), dict) else each for each in configs
    ]
    for file, theirs in zip(files[1:], others, strict=True):
        if differing := find_differing(first, theirs):
            raise ConfigError(
                f"{file} learned with another {', '.join(differing)} than {files[0]}: "
                "average policies that see and move alike."
            )
