"""The pretrained policy, read once for all tests of this folder."""

import functools

import torch

import torchgrasp
from torchgrasp.config.trained_policy import TrainedPolicy


@functools.cache
def policy() -> TrainedPolicy:
    torch.set_num_threads(1)
    return torchgrasp.load_policy("pretrained")
