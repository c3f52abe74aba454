"""``torchgrasp average``: one policy of several that were trained on from one start, or of one, changed."""

from __future__ import annotations

import argparse
from pathlib import Path

from torchgrasp.errors import ConfigError

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
        "--uncorrected",
        action="store_true",
        help="leave out what reinforcement corrected (model.residual) in those of the policies that have it; "
        "one policy is enough then",
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
    from torchgrasp.config.averaging import check_averaged, load_uncorrected
    from torchgrasp.config.weights_files import check_weights, weights_file
    from torchgrasp.runs import load_weights
    from torchgrasp.runs.averaged_weights import average_weights

    if len(args.policies) < 2 and not (args.mirrored or args.uncorrected):
        raise ConfigError("One policy is its own mean: give two or more, --mirrored or --uncorrected.")
    for name in args.policies:
        check_weights("policy", name)
    files = [weights_file(Path(name)) for name in args.policies]
    check_averaged(files, mirrored=args.mirrored, uncorrected=args.uncorrected, trust=args.trust)
    load = load_uncorrected if args.uncorrected else load_weights
    names = average_weights(files, Path(args.output), mirrored=args.mirrored, load=load)
    count = f"{len(files)} policies" if len(files) > 1 else "one policy"
    print(f"Written to {args.output}: {', '.join(names)} of {count}")
    return 0
