"""The Triton kernels: what they compute, in Triton's interpreter, and what happens where they fail."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from torchgrasp.ops import ball_max, cuda, dense


def test_kernels_equal_the_definitions():
    script = Path(__file__).parent / "interpreted_kernels.py"
    environment = {**os.environ, "TRITON_INTERPRET": "1"}
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() == "agree"


class _Reversed:
    """Kernels that choose other points than they should."""

    @staticmethod
    def farthest_point_sample(xyz, first, mask, num):
        return dense.farthest_point_sample(xyz, first, mask, num).flip(-1)

    ball_query = staticmethod(dense.ball_query)


def test_wrong_kernels_are_noticed():
    cuda.check_against_dense(dense, torch.device("cpu"))
    with pytest.raises(ValueError, match="other points"):
        cuda.check_against_dense(_Reversed, torch.device("cpu"))


def test_the_cpu_takes_no_kernels():
    assert cuda.cuda_kernels(torch.rand(5, 3)) is None
    assert not ball_max.serves(torch.rand(2, 5, 3))
