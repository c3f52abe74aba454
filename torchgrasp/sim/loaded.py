"""Imports SAPIEN at once, for a process whose copies are to share it."""

from torchgrasp.sim._sapien import load_sapien

load_sapien()
