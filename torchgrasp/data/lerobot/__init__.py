"""Demonstrations to and from LeRobotDataset v3, extra ``lerobot``.

Only the exchange lives here: what demonstrations hold is decided one folder up.
"""
