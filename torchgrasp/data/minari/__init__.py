"""Demonstrations to and from Minari datasets, extra ``minari``.

Only the exchange lives here: what demonstrations hold is decided one folder up.
"""
