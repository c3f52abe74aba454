"""When the hand grasps: after the last step, or as soon as the target is between the fingers."""

from __future__ import annotations

from typing import Literal

import numpy as np

from torchgrasp.objects.gripper import MAX_OPENING, PAD_HALF, pad_rays
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.raycast import embree_scene

GraspTrigger = Literal["horizon", "between_fingers"]
GRASP_TRIGGERS: tuple[GraspTrigger, ...] = ("horizon", "between_fingers")
# Share of the rays from pad to pad that must meet the target. A grasp of the expert's covers more.
_COVERED = 0.5


def is_between_fingers(target: GraspObject, T_base_object: np.ndarray, T_base_ee: np.ndarray) -> bool:
    """Whether the target fills half of the space between the open fingers' pads.

    49 rays from one pad's face tell: half of them must meet the target before the other pad, and so must
    one in the pads' half that is nearer to the palm, that the object be well inside.
    """
    T_object_ee = np.linalg.solve(T_base_object, T_base_ee)
    origins, directions = pad_rays(T_object_ee[None])
    rays = embree_scene(target).scene.run(
        origins[0, 0].astype(np.float32), directions[0, 0].astype(np.float32), query="DISTANCE"
    )
    hit = rays < MAX_OPENING
    depth = (origins[0, 0] - T_object_ee[:3, 3]) @ T_object_ee[:3, 2]
    palmward = depth < depth.mean() - PAD_HALF[1] / 3
    return bool(hit.mean() >= _COVERED and hit[palmward].any())
