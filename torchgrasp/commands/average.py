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
        help="act by the mean over the hand's reflections as well, which a policy needs to have learned from "
        "(RandomMirror); one policy is enough then",
    )
    parser.add_argument(
        "--trust",
        nargs="+",
        default=[],
        metavar="PACKAGE",
        help="packages besides torchgrasp and torchrl whose classes the files may name",
    )
    parser.add_argument("--output", default="policy.safetensors", help="the weights file to write")


def run(args: argparse.Namespace) -> int:
    """Write the mean, and name it."""
    from torchgrasp.config.averaging import check_averaged
    from torchgrasp.config.weights_files import check_weights, weights_file
    from torchgrasp.runs.averaged_weights import average_weights

    for name in args.policies:
        check_weights("policy", name)
    files = [weights_file(Path(name)) for name in args.policies]
    check_averaged(files, mirrored=args.mirrored, trust=args.trust)
    names = average_weights(files, Path(args.output), mirrored=args.mirrored)
    count = f"{len(files)} policies" if len(files) > 1 else "one policy"
    print(f"Written to {args.output}: {', '.join(names)} of {count}")
    return 0
