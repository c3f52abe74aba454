"""The table: a static slab whose top lies at z = 0 of the base frame."""

from __future__ import annotations

import numpy as np

from torchgrasp.sim._sapien import sapien

TABLE_LOWER = np.array([0.12, -0.65, -0.05])
TABLE_UPPER = np.array([1.12, 0.65, 0.0])


def build_table(scene: sapien.Scene, material: sapien.physx.PhysxMaterial) -> sapien.Entity:
    """Add the table to a scene."""
    builder = scene.create_actor_builder()
    builder.set_physx_body_type("static")
    half = (TABLE_UPPER - TABLE_LOWER) / 2
    builder.add_box_collision(sapien.Pose((TABLE_LOWER + TABLE_UPPER) / 2), half.tolist(), material)
    return builder.build("table")
