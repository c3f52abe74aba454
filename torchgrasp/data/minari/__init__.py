"""Demonstrations to and from Minari datasets."""
