"""Pictures of episodes for a run's report, where matplotlib is installed and the policy sees points."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.evaluation.grasp_prediction import nearest_grasp
from torchgrasp.geometry import goal_to_pose
from torchgrasp.report.drawing import observed_points
from torchgrasp.report.plots import can_plot, plot_grasps, to_png
from torchgrasp.report.run_page import Picture
from torchgrasp.rollouts.episode_pool import Episode

_AT_MOST = 6  # pictures of each kind: a report is looked through, not archived


class FailurePictures:
    """The last cloud and the hand before it closed, of the first episodes that failed."""

    def __init__(self) -> None:
        self.pictures: list[Picture] = []

    def add(self, episode: Episode) -> None:
        """Draw the episode if it failed and there is room."""
        if not episode.success and len(self.pictures) < _AT_MOST:
            scene = f"world {episode.world}, episode {episode.number}"
            words = f"{episode.object_name}, {scene}: {episode.failure}"
            _draw(self.pictures, episode.steps["next"][-1:], {"hand at the end": np.eye(4)}, words)


class GraspPictures:
    """Predicted grasps half way along the expert's first trajectories, as in Fig. 8."""

    def __init__(self) -> None:
        self.pictures: list[Picture] = []

    def add(self, object_name: str, steps: TensorDictBase, predicted: Tensor, known: Tensor) -> None:
        """Draw the middle one of the T steps if there is room.

        Args:
            object_name: for the caption.
            steps: (T,) with POINTS and the expert's GOAL.
            predicted: (T, 4, 4) predictions, ee frame.
            known: (T, K, 4, 4) the object's grasps, ee frame.
        """
        if len(self.pictures) < _AT_MOST:
            t = len(steps) // 2
            hands = {
                "predicted": predicted[t],
                "nearest known grasp": nearest_grasp(predicted[t], known[t]),
                "expert's goal": goal_to_pose(steps[keys.GOAL][t]),
            }
            hands = {name: hand.double().numpy() for name, hand in hands.items()}
            _draw(self.pictures, steps[t : t + 1], hands, f"{object_name}, step {t} of {len(steps)}")


def _draw(
    pictures: list[Picture], step: TensorDictBase, hands: Mapping[str, np.ndarray], caption: str
) -> None:
    """Add the cloud of a step (1,) with hand poses of its ee frame, both drawn upright in the base frame."""
    if not can_plot() or step.get(keys.POINTS, None) is None:
        return
    T_base_ee, points = (step.get(key)[0].double().numpy() for key in (keys.T_BASE_EE, keys.POINTS))
    cloud = observed_points(points)
    placed = {name: T_base_ee @ hand for name, hand in hands.items()}
    figure = plot_grasps(cloud @ T_base_ee[:3, :3].T + T_base_ee[:3, 3], placed)
    pictures.append(Picture(to_png(figure), caption))
